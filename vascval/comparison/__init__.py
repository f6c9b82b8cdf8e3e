"""Cast against synthetic trees: :func:`compare` and what it returns."""

from vascval.comparison.compare import Comparison, compare
from vascval.comparison.location import Location
from vascval.comparison.territories import Territories

__all__ = ["Comparison", "Location", "Territories", "compare"]

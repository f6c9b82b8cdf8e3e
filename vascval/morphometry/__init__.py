"""Measures of one tree: :func:`analyze` and the parts it is made of."""

from vascval.morphometry.analysis import Analysis, analyze
from vascval.morphometry.junctions import Monopodial

__all__ = ["Analysis", "Monopodial", "analyze"]

"""Which unit of length a file is in, when it does not say so plainly; every guess comes with its sentence."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from vascval.core.errors import InputError
from vascval.core.units import MM_PER

_SPELLINGS = {
    "um": ("um", "µm", "μm", "micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres"),
    "mm": ("mm", "millimeter", "millimeters", "millimetre", "millimetres"),
    "cm": ("cm", "centimeter", "centimeters", "centimetre", "centimetres"),
    "m": ("m", "meter", "meters", "metre", "metres"),
}
_UNIT = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}

_LARGEST_BODY_MM = 600.0
"""No tree of vessels that is looked at as one is wider than this in millimetres."""
_FARTHEST_MM = 1500.0
"""No scanner has its origin farther away than this."""
_THICKEST_MM = 30.0
"""No vessel has a larger radius than this in millimetres."""


def unit_named(text: str) -> str | None:
    """The unit that a text such as ``"um"``, ``"[mm]"`` or ``"Micrometers"`` names, or None."""
    return _UNIT.get(text.strip().strip("[]()\"'.").lower())


def unit_of_name(name: str) -> str | None:
    """The unit in an array's name: ``radius_mm``, ``Diameter [um]``; None when there is none."""
    words = [word for word in re.split(r"[\s_()\[\]]+", name) if word]
    return unit_named(words[-1]) if len(words) > 1 else None


def require_unit(unit: str) -> str:
    """The unit by its short name.

    :raises InputError: when it is not a unit of length.
    """
    known = unit_named(unit)
    if known is None:
        raise InputError(f"{unit!r} is no unit of length; choose one of {', '.join(MM_PER)}")
    return known


def unit_in_texts(texts: Mapping[str, str]) -> str | None:
    """The unit that a file's field data state, under a name like ``unit`` or ``LengthUnits``."""
    for name, text in texts.items():
        if re.search(r"units?$", name, re.IGNORECASE) and unit_named(text):
            return unit_named(text)
    return None


def guess_unit(points: np.ndarray, radius: np.ndarray, names: Iterable[str] = ()) -> tuple[str, str]:
    """A unit, and the sentence that says why: by the program that wrote the file, else by size.

    :param points: (P, 3) in the unknown unit; ``radius`` likewise; ``names`` of the arrays in the file.
    """
    names = set(names)
    if {"BifurcationId", "CenterlineSectionArea"} <= names:
        return "cm", "no unit is given; SimVascular wrote it, which works in centimetres"
    if "MaximumInscribedSphereRadius" in names:
        return "mm", "no unit is given; VMTK wrote it, taken as the millimetres of medical images"
    extent, far, thick = float(np.ptp(points, axis=0).max()), float(np.abs(points).max()), float(radius.max())
    why = ""
    if extent > _LARGEST_BODY_MM:
        why = f"it would be {extent:.4g} mm wide"
    elif far > _FARTHEST_MM:
        why = f"it would lie {far:.4g} mm from the origin"
    elif thick > _THICKEST_MM:
        why = f"its largest radius would be {thick:.4g} mm"
    if why:
        return "um", f"no unit is given; taken as micrometres, as in millimetres {why}"
    return "mm", f"no unit is given; taken as millimetres (it is {extent:.4g} mm wide, largest radius {thick:.4g} mm)"

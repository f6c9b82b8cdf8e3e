"""Reading and writing trees, whatever their format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.errors import InputError, printable
from vascval.core.tree import Tree
from vascval.core.validation import Claims, require_made_well
from vascval.io import xml_guard
from vascval.io.assembly import Keep, assemble
from vascval.io.foreign import sketch_of
from vascval.io.gxl import read_gxl
from vascval.io.header_checks import first_bytes
from vascval.io.length_units import require_unit
from vascval.io.swc import read_swc, write_swc
from vascval.io.tables import write_table
from vascval.io.volumes import is_volume_path
from vascval.io.vtk_legacy import read_legacy
from vascval.io.vtp import is_own, own_tree, write_vtp
from vascval.io.vtp_xml import read_vtp

__all__ = ["is_tree_path", "is_volume_path", "read_tree", "write_swc", "write_table", "write_tree", "write_vtp"]

_LEAST_RADIUS = 1e-5
"""Of the thickest vessel, in widths of the tree; real trees have a hundredth."""
SUFFIXES = (".vtp", ".vtk", ".swc", ".gxl", ".xml")


def is_tree_path(path: Path | str) -> bool:
    """Whether the name is that of a tree file."""
    return str(path).lower().endswith(SUFFIXES)


def read_tree(path: Path | str, *, unit: str | None = None, keep: Keep = "largest") -> Tree:
    """The tree in a VTP, legacy VTK, SWC or GXL file, in millimetres, oriented away from its root.

    Our own VTP files read back as they were written. Whatever had to be guessed or mended in others stands as
    sentences in ``meta["guesses"]``: the unit, the root, which array is the radius, loops, separate trees; so does
    what makes one doubt that radii and positions have one unit.

    :param unit: of positions and radii (``um``, ``mm``, ``cm``, ``m``); by default what the file says, else a guess.
    :param keep: what to do with several trees in one file: keep the ``"largest"`` by length, or ``"error"``.
    :raises InputError: with the name of the file, what is wrong and the remedy.
    """
    path = Path(path)
    unit = None if unit is None else require_unit(unit)
    head = first_bytes(path, 4096)
    try:
        return _read(path, head, unit, keep)
    except InputError as error:
        if str(error).startswith(printable(f"{path}:")):
            raise
        raise InputError(f"{path}: {error}") from error
    except MemoryError as error:
        raise InputError(f"{path}: does not fit into memory; is it damaged?") from error


def _read(path: Path, head: bytes, unit: str | None, keep: Keep) -> Tree:
    if not head:
        raise InputError("the file is empty; check how it was written")
    if head.startswith(b"# vtk DataFile"):
        data = read_legacy(path)
        kind, (sketch, unit) = "legacy VTK", sketch_of(data, unit)
    elif head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") or head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        if _root_element(path) == "gxl":
            kind, (sketch, unit) = "GXL", read_gxl(path, unit)
        else:
            data = read_vtp(path)
            if is_own(data):
                if unit not in (None, "mm"):
                    raise InputError(f"its arrays are in mm by their names, not {unit}; leave the unit away")
                return own_tree(data)
            kind, (sketch, unit) = "VTP", sketch_of(data, unit)
    elif b"\0" not in head and (path.suffix.lower() == ".swc" or head.lstrip()[:1] in b"#0123456789"):
        kind, (sketch, unit) = "SWC", read_swc(path, unit)
    else:
        raise InputError("is no tree that can be read; give VTP, legacy VTK (poly data), SWC or GXL")
    tree = assemble(sketch, keep=keep, meta={"source": path.name, "format": kind, "unit": unit})
    return replace(tree, meta={**tree.meta, "guesses": [*tree.meta["guesses"], *_doubts(tree)]})


def _doubts(tree: Tree) -> list[str]:
    wide, thickest = float(np.ptp(tree.position_mm, axis=0).max()), float(tree.radius_mm.max())
    if tree.n_segments == 0 or _LEAST_RADIUS * wide <= thickest <= wide:
        return []
    return [
        f"the largest radius is {thickest:.4g} mm and the tree {wide:.4g} mm wide: check that radii and positions are "
        "in one unit"
    ]


def _root_element(path: Path) -> str:
    names: list[str] = []

    def first(name: str, _: dict[str, str]) -> bool:
        names.append(name)
        return True

    xml_guard.parse(path, first)
    return names[0]


def write_tree(
    tree: Tree, path: Path | str, provenance: Mapping[str, Any] | None = None, *, claims: Claims | None = None
) -> None:
    """A tree that was made here, as VTP or SWC by the suffix (see :func:`write_vtp`, :func:`write_swc`).

    :param claims: what it is said to hold besides what every tree should.
    :raises InputError: for another suffix or a place that cannot be written.
    :raises ComputationError: when the tree breaks a rule or a claim; nothing is written.
    """
    writers = {".vtp": write_vtp, ".swc": write_swc}
    writer = writers.get(Path(path).suffix.lower())
    if writer is None:
        raise InputError(f"{path}: trees are written as .vtp or .swc; choose one of these")
    require_made_well(tree, claims)
    writer(tree, path, provenance)

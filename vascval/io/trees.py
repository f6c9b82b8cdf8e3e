"""Reading and writing trees, whatever their format."""

from __future__ import annotations

from pathlib import Path

from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.io.image_headers import first_bytes
from vascval.io.polydata import read_vtp
from vascval.io.tables import write_table
from vascval.io.vtp import is_own, own_tree, write_vtp

__all__ = ["is_tree_path", "is_volume_path", "read_tree", "write_table", "write_vtp"]

TREE_SUFFIXES = (".vtp", ".vtk", ".swc", ".gxl", ".gxl.xml", ".xml")
VOLUME_SUFFIXES = (".nrrd", ".nhdr", ".nii", ".nii.gz", ".mha", ".mhd", ".tif", ".tiff")


def is_tree_path(path: Path | str) -> bool:
    """Whether the name is that of a tree file."""
    return str(path).lower().endswith(TREE_SUFFIXES)


def is_volume_path(path: Path | str) -> bool:
    """Whether the name is that of a volume, or a folder (of slices)."""
    return str(path).lower().endswith(VOLUME_SUFFIXES) or Path(path).is_dir()


def read_tree(path: Path | str, *, unit: str | None = None) -> Tree:
    """A tree from a file."""
    path = Path(path)
    if not first_bytes(path, 1):
        raise InputError(f"{path}: the file is empty; check how it was written")
    data = read_vtp(path)
    if not is_own(data):
        raise InputError(f"{path}: its lines do not form a rooted tree with a parent for each; convert it first")
    try:
        return own_tree(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error

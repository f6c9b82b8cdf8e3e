"""The domain that a configuration asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from generator.config import DomainConfig
from generator.domain import Box, Domain
from generator.domain_shapes import ShapeDomain
from generator.domain_surface import SurfaceDomain
from generator.domain_volume import VoxelDomain
from vascval.core.errors import InputError
from vascval.io.quiet import vtk_messages
from vascval.io.volumes import is_volume_path, read_volume

SURFACES = (".stl", ".obj", ".vtk", ".vtp", ".ply")


def make_domain(config: DomainConfig) -> Domain:
    """:raises InputError: when the file is missing, foreign or damaged, or what it holds is no domain; it is named."""
    if config.box_mm is not None:
        return Box(np.array(config.box_mm))
    if config.shape is not None:
        return ShapeDomain(config.shape)
    assert config.file is not None
    path = config.file
    if not path.exists():
        raise InputError(f"{path}: no such file; check domain.file")
    try:
        if path.suffix.lower() in SURFACES:
            return SurfaceDomain(*read_surface(path), keep=config.keep)
        if is_volume_path(path):
            volume = read_volume(path)
            return VoxelDomain(volume, label=config.label, closing_mm=config.closing_mm, keep=config.keep)
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    raise InputError(
        f"{path}: neither a volume nor a surface by its name; volumes are NRRD, NIfTI, MetaImage or TIFF, surfaces "
        f"{', '.join(suffix[1:].upper() for suffix in SURFACES)}"
    )


def read_surface(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (P, 3) in mm and triangles (T, 3) of a surface file; polygons are cut into triangles.

    :raises InputError: when it is no surface or is damaged.
    """
    import pyvista

    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; check how it was written")
    _require_whole_stl(path)
    with vtk_messages() as messages:
        try:
            data = pyvista.read(path)
        except (OSError, ValueError, RuntimeError, TypeError, AttributeError) as error:
            raise InputError(f"{path}: cannot be read as a surface ({error}); it is damaged or of another kind") from error
        said = messages()
        surface = data.triangulate() if isinstance(data, pyvista.PolyData) and not said else None
    if said:
        raise InputError(f"{path}: cannot be read as a surface ({said}); it is truncated or damaged")
    if surface is None or surface.n_cells == 0:
        raise InputError(f"{path}: holds no polygons; a closed surface is needed")
    faces = np.asarray(surface.faces)
    if faces.size != 4 * surface.n_cells:
        raise InputError(f"{path}: holds lines or points beside polygons; a closed surface alone is needed")
    return np.asarray(surface.points, dtype=np.float64), faces.reshape(-1, 4)[:, 1:].astype(np.int64)


def _require_whole_stl(path: Path) -> None:
    """Binary STL states its number of triangles; VTK reads a truncated one without a word."""
    if path.suffix.lower() != ".stl":
        return
    with path.open("rb") as stream:
        head = stream.read(84)
    if head[:5].lower() == b"solid" or len(head) < 84:
        if b"endsolid" not in path.read_bytes()[-512:].lower() and head[:5].lower() == b"solid":
            size = 84 + 50 * int.from_bytes(head[80:84], "little")
            if size != path.stat().st_size:
                raise InputError(f"{path}: does not end with endsolid; it is truncated or damaged")
        return
    size = 84 + 50 * int.from_bytes(head[80:84], "little")
    if path.stat().st_size < size:
        raise InputError(f"{path}: is {path.stat().st_size:,} bytes long where {size:,} are announced; it is truncated")

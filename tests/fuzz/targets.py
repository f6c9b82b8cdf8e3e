"""The readers, and what must be true of whatever they return."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from generator.config import DomainConfig, load
from generator.domains import make_domain
from generator.framework import read_points
from tests.fuzz import seeds
from vascval.core.errors import InputError
from vascval.io.documents import read_reference_table
from vascval.io.trees import read_tree
from vascval.io.volumes import read_volume

PACKED = 1100
"""Bytes out of one by the densest packing that is read (zlib)."""


@dataclass(frozen=True)
class Target:
    """A reader: ``read(path)`` raises ``InputError`` or AssertionError when what it returns is unsound.

    ``seeds()`` are sound files; ``companions`` lie beside the file; ``packed`` wraps a mutated file for half of the
    cases. It may take ``fixed`` bytes of memory whatever the size of the file (buffers and code of the libraries that
    it loads) and ``factor`` for each byte of it.
    """

    name: str
    suffix: str
    read: Callable[[Path], object]
    seeds: Callable[[], tuple[bytes, ...]]
    companions: Mapping[str, bytes] = field(default_factory=dict)
    packed: Callable[[bytes], bytes] | None = None
    factor: int = 100
    fixed: int = 48 << 20


def _tree(path: Path) -> None:
    tree = read_tree(path)
    assert tree.n_segments > 0
    assert (tree.parent[1:] < np.arange(1, tree.n_nodes)).all()
    for name in ("position_mm", "radius_mm", "length_mm"):
        assert np.isfinite(getattr(tree, name)).all(), f"{name} is not finite"
    assert np.isfinite(tree.volume_mm3), "the volume is not finite"
    assert isinstance(tree.meta["guesses"], list)


def _volume(path: Path) -> None:
    volume = read_volume(path, spacing_mm=(1.0, 1.0, 1.0) if path.suffix == ".tif" else None)
    assert volume.values.ndim == 3
    assert np.isfinite(volume.values).all()
    assert np.isfinite(volume.to_world(np.array(volume.values.shape[::-1]))).all(), "the frame is not finite"
    float(volume.values.sum(dtype=np.float64))  # touches every byte: values beyond the memory given would show


def _surface(path: Path) -> None:
    domain = make_domain(DomainConfig(file=path))
    assert np.isfinite(domain.volume_mm3)
    assert domain.volume_mm3 > 0


def _points(path: Path) -> None:
    points = read_points(path)
    assert points.ndim == 2
    assert points.shape[1] == 3
    assert np.isfinite(points).all()


def _reference(path: Path) -> None:
    table = read_reference_table(path)
    assert table.generations["generation"].is_unique
    table.document()


def _config(path: Path) -> None:
    config = load(str(path))
    try:
        for what in (config.flow(), config.physics(), config.growth_options(), config.topology.options()):
            assert what is not None
    except InputError as error:  # a value is refused where it is used, which knows no file
        raise InputError(f"{path}: {error}") from error


def _gz(data: bytes) -> bytes:
    return gzip.compress(data, 1, mtime=0)


_GRID = 144 << 20  # of up to 400,000 cells, into which a surface is sorted
_RAW = seeds.values().tobytes()
_BESIDE = {"a.raw": _RAW, "s001.raw": _RAW[:12], "s002.raw": _RAW[12:]}

TARGETS = {
    target.name: target
    for target in (
        Target("vtp", ".vtp", _tree, seeds.vtp, factor=PACKED),
        Target("vtk", ".vtk", _tree, seeds.vtk),
        Target("swc", ".swc", _tree, seeds.swc),
        Target("gxl", ".gxl", _tree, seeds.gxl),
        Target("nrrd", ".nrrd", _volume, seeds.nrrd, factor=PACKED),
        Target("nhdr", ".nhdr", _volume, seeds.nhdr, _BESIDE),
        Target("nii", ".nii", _volume, seeds.nii),
        Target("nii.gz", ".nii.gz", _volume, seeds.nii, packed=_gz, factor=PACKED),
        Target("mha", ".mha", _volume, seeds.mha, factor=PACKED),
        Target("mhd", ".mhd", _volume, seeds.mhd, _BESIDE),
        Target("tif", ".tif", _volume, seeds.tif, factor=PACKED),
        Target("stl", ".stl", _surface, seeds.stl, fixed=_GRID),
        Target("obj", ".obj", _surface, seeds.obj, fixed=_GRID),
        Target("surface.vtk", ".vtk", _surface, seeds.surface_vtk, fixed=_GRID),
        Target("surface.vtp", ".vtp", _surface, seeds.surface_vtp, fixed=_GRID),
        Target("points", ".csv", _points, seeds.points_csv),
        Target("reference", ".csv", _reference, seeds.reference_csv, factor=170),
        Target("config", ".toml", _config, seeds.toml),
    )
}

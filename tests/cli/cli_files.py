"""A small tree and its image, written by hand here and not by the project, and a look at what a command wrote."""

import hashlib
from pathlib import Path

import numpy as np

from vascval.core.tree import Topology, Tree

VOXEL_MM = 0.5


def small_tree() -> Tree:
    """Seven segments in three generations, in space, radii by Murray's law with exponent 3."""
    parent = [-1, 0, 1, 1, 2, 2, 3, 3]
    position = [(0, 0, 0), (0, 0, 14), (10, 0, 22), (-10, 0, 22)]
    position += [(12, 8, 32), (14, -8, 30), (-12, 8, 30), (-14, -8, 32)]
    radius = np.array([0, 3, 2.5, 2.2, 2.0, 1.97, 1.75, 1.74])
    return Tree(Topology(np.array(parent)), np.array(position, dtype=float), radius)


def write_nrrd(path, values, *, spacing=(VOXEL_MM,) * 3, origin=(0.0, 0.0, 0.0), **fields: str) -> Path:
    """An attached raw NRRD file of ``values`` (z, y, x); ``fields`` add to its header or replace what is there."""
    types = {"uint8": "uint8", "int16": "int16", "float32": "float"}
    steps = [",".join(str(s if k == axis else 0.0) for k in range(3)) for axis, s in enumerate(spacing)]
    header = {
        "type": types[values.dtype.name],
        "dimension": str(values.ndim),
        "space": "left-posterior-superior",
        "sizes": " ".join(str(n) for n in values.shape[::-1]),
        "space directions": " ".join(f"({step})" for step in steps),
        "kinds": " ".join(["domain"] * 3),
        "endian": "little",
        "encoding": "raw",
        "space origin": "({},{},{})".format(*origin),
        **{name.replace("_", " "): text for name, text in fields.items()},
    }
    text = "NRRD0004\n" + "".join(f"{name}: {value}\n" for name, value in header.items() if value) + "\n"
    path.write_bytes(text.encode() + values.tobytes())
    return path


def draw(tree: Tree, origin: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """(z, y, x) uint8: 1 where a voxel's centre lies in a rounded tube around a segment."""
    index = np.indices(shape)[::-1].reshape(3, -1).T
    point = origin + VOXEL_MM * index
    inside = np.zeros(len(point), dtype=bool)
    for i in range(1, tree.n_nodes):
        a, b = tree.position_mm[tree.parent[i]], tree.position_mm[i]
        along = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        inside |= ((point - a - along[:, None] * (b - a)) ** 2).sum(axis=1) <= tree.radius_mm[i] ** 2
    return inside.reshape(shape).astype(np.uint8)


def contents(directory: Path) -> dict[str, str]:
    """Every file below ``directory`` with the checksum of its bytes."""
    files = (path for path in sorted(directory.rglob("*")) if path.is_file())
    return {path.relative_to(directory).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}

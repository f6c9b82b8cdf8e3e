"""Triangles from STL, OBJ, VTK and VTP files.

None is read by VTK, which crashes on damaged ones. Polygons are cut into fans of triangles.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from vascval.core.errors import InputError
from vascval.io.vtk_legacy import read_legacy
from vascval.io.vtp_xml import read_vtp

SUFFIXES = (".stl", ".obj", ".vtk", ".vtp")
Surface = tuple[np.ndarray, np.ndarray]


def read_surface(path: Path) -> Surface:
    """Vertices (P, 3) in mm, as given, and triangles (T, 3) of a surface file.

    :raises InputError: when it is empty, damaged, or holds no polygons.
    """
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; check how it was written")
    readers = {".stl": _read_stl, ".obj": _read_obj, ".vtk": _read_vtk, ".vtp": _read_vtk}
    points, faces = readers[path.suffix.lower()](path)
    if len(faces) == 0:
        raise InputError(f"{path}: holds no polygons; a closed surface is needed")
    if faces.min() < 0 or faces.max() >= len(points):
        raise InputError(f"{path}: a polygon names a vertex that is not there; the file is truncated or damaged")
    return points, faces


def _read_stl(path: Path) -> Surface:
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        kind = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])
        points = np.frombuffer(data, kind, offset=84)["corner"].reshape(-1, 3).astype(np.float64)
    elif data.lstrip()[:5].lower() == b"solid" and b"\0" not in data[:1000]:
        if b"endsolid" not in data[-1000:].lower():
            raise InputError(f"{path}: does not end with endsolid; it is truncated or damaged")
        rows = [line.split()[1:4] for line in data.decode("latin-1").splitlines() if line.split()[:1] == ["vertex"]]
        points = _numbers(path, rows)
    else:
        raise InputError(
            f"{path}: is {len(data):,} bytes long where {84 + 50 * max(count, 0):,} are announced; it is truncated or "
            "no STL"
        )
    if len(points) % 3:
        raise InputError(f"{path}: {len(points)} vertices do not make whole triangles; it is truncated or damaged")
    return points, np.arange(len(points)).reshape(-1, 3)


def _read_obj(path: Path) -> Surface:
    rows: list[list[str]] = []
    polygons: list[list[int]] = []
    for number, line in enumerate(path.read_text("latin-1").splitlines(), start=1):
        words = line.split()
        if words[:1] == ["v"]:
            rows.append(words[1:4])
        elif words[:1] == ["f"]:
            try:
                index = [int(word.split("/")[0]) for word in words[1:]]
            except ValueError:
                raise InputError(f"{path}: line {number} is no polygon ({line[:40]!r}); the file is damaged") from None
            if len(index) < 3:
                raise InputError(f"{path}: line {number} has {len(index)} corners; the file is truncated or damaged")
            polygons.append([i - 1 if i > 0 else len(rows) + i for i in index])
    return _numbers(path, rows), _fans(polygons)


def _read_vtk(path: Path) -> Surface:
    data = read_vtp(path, "polygons") if path.suffix.lower() == ".vtp" else read_legacy(path, "polygons")
    corner = data.connectivity
    if (np.diff(data.offsets) == 3).all():
        return data.points, corner.reshape(-1, 3)
    return data.points, _fans([corner[a:b].tolist() for a, b in pairwise(data.offsets)])


def _numbers(path: Path, rows: list[list[str]]) -> np.ndarray:
    try:
        return np.array(rows, dtype=np.float64).reshape(-1, 3)
    except ValueError:
        raise InputError(f"{path}: a vertex is not three numbers; the file is truncated or damaged") from None


def _fans(polygons: list[list[int]]) -> np.ndarray:
    fans = [(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)]
    try:
        return np.array(fans, dtype=np.int64).reshape(-1, 3)
    except OverflowError:
        raise InputError("a polygon names a vertex that is not there; the file is damaged") from None

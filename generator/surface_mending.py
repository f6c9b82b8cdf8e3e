"""Makes a triangle surface closed, consistently turned and of one body, or says why that cannot be done."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from generator import _surface_kernels as kernels
from vascval.core.errors import InputError

_HOLE = 0.1
"""Largest hole that is filled: its edge, relative to the diagonal of the surface's bounding box, times pi."""
_SPECKS = 1e-3


def mended(points_mm: np.ndarray, faces: np.ndarray, keep: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Vertices, triangles turned outward (inward around cavities), and notes on what was done.

    Doubled vertices are merged and triangles without area dropped; small holes are filled; triangles are turned alike
    and outward. Bodies that together hold less than a thousandth of the volume are dropped.

    :raises InputError: on vertices that are not finite, on holes too wide to fill, edges of more than two triangles,
        and separate bodies unless ``keep`` is ``largest``.
    """
    points = np.asarray(points_mm, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"{bad.size} vertices of the surface are not finite (first: {bad[0]}); mend or drop them")
    if len(faces) < 4:
        raise InputError(f"the surface has {len(faces)} triangles; a closed one has at least 4")
    notes: list[str] = []
    points, faces = _merged(points, faces, notes)
    if len(faces) < 4:
        raise InputError(f"the surface has {len(faces)} triangles with an area; a closed one has at least 4")
    points, faces = _filled(points, faces, notes)
    faces = _turned_alike(faces, notes)
    return _one_body(points, faces, keep, notes)


def _merged(points: np.ndarray, faces: np.ndarray, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Without doubled vertices (STL has one per corner) and without triangles that have lost their area by it."""
    scale = max(float(np.abs(points).max()), 1e-300)
    _, first, index = np.unique(np.round(points / (1e-7 * scale)).astype(np.int64), axis=0, return_index=True,
                                return_inverse=True)  # fmt: skip
    faces = index.reshape(-1)[faces]
    flat = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 0] == faces[:, 2])
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    good = np.zeros(len(faces), dtype=bool)
    good[once] = True
    good &= ~flat
    if not good.all():
        notes.append(f"{np.count_nonzero(~good)} triangles without area, or doubled, were dropped")
    return points[first], faces[good]


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Undirected edges (E, 2), how many triangles meet there, and of each directed edge (3T, 2) the undirected one."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, index, count = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    return edges, count, index.reshape(-1)


def _filled(points: np.ndarray, faces: np.ndarray, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Small holes closed by a fan about their centre."""
    edges, count, _ = _edges(faces)
    if (count > 2).any():
        at = points[edges[count > 2][0]].mean(axis=0).round(2).tolist()
        raise InputError(
            f"{np.count_nonzero(count > 2)} edges of the surface belong to more than two triangles (first: near "
            f"{at}); it is no boundary of a body: mend it"
        )
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, _, index = _edges(faces)
    open_edges = directed[count[index] == 1]
    if not len(open_edges):
        return points, faces
    after = dict(open_edges[:, ::-1].tolist())
    limit = _HOLE * np.pi * float(np.linalg.norm(np.ptp(points, axis=0)))
    loops = 0
    while after:
        loop = [next(iter(after))]
        while loop[-1] in after:
            loop.append(after.pop(loop[-1]))
        length = float(np.linalg.norm(np.diff(points[loop], axis=0), axis=1).sum())
        if loop[0] != loop[-1] or length > limit:
            at = points[loop].mean(axis=0).round(2).tolist()
            raise InputError(
                f"the surface is open: a hole with an edge of {length:.3g} mm near {at} is too wide to be filled "
                "without guessing; close it"
            )
        centre = len(points)
        points = np.vstack([points, points[loop[:-1]].mean(axis=0)])
        fan = [(a, b, centre) for a, b in pairwise(loop)]
        faces = np.vstack([faces, np.array(fan, dtype=np.int64)])
        loops += 1
    notes.append(f"{loops} holes of the surface were filled")
    return points, faces


def _components(faces: np.ndarray) -> np.ndarray:
    """(T,) which shell each triangle belongs to; every edge has two triangles."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    _, _, index = _edges(faces)
    pairs = (np.argsort(index, kind="stable") // 3).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(faces),) * 2)
    return connected_components(graph, directed=False)[1]


def _turned_alike(faces: np.ndarray, notes: list[str]) -> np.ndarray:
    """Neighbours run through their common edge in opposite directions; triangles are turned until all do."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    if len(np.unique(directed, axis=0)) == len(directed):
        return faces
    import pyvista

    count = len(faces)
    surface = pyvista.PolyData(np.zeros((int(faces.max()) + 1, 3)), np.column_stack([np.full(count, 3), faces]).ravel())
    turned = surface.compute_normals(
        cell_normals=False, point_normals=True, consistent_normals=True, split_vertices=False,
        auto_orient_normals=False, non_manifold_traversal=False,
    )  # fmt: skip
    result = np.asarray(turned.faces).reshape(-1, 4)[:, 1:].astype(np.int64)
    directed = result[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    if len(result) != count or len(np.unique(directed, axis=0)) < len(directed):
        raise InputError("the surface has no inside and outside (like a Moebius strip); mend it")
    notes.append("triangles of the surface were turned to face one way")
    return result


def _one_body(
    points: np.ndarray, faces: np.ndarray, keep: str, notes: list[str]
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Shells turned outward, or inward where they bound a cavity; bodies counted."""
    component = _components(faces)
    shells = np.split(faces[np.argsort(component, kind="stable")], np.cumsum(np.bincount(component))[:-1])
    volume = np.array([_signed(points[shell]) for shell in shells])
    total = np.abs(volume).sum()
    kept = [c for c in np.argsort(-np.abs(volume)) if abs(volume[c]) > _SPECKS * total / len(shells)]
    if len(kept) < len(shells):
        notes.append(f"{len(shells) - len(kept)} specks of the surface were dropped")
    if not kept:
        raise InputError("the surface encloses no volume; is it a flat sheet?")
    depth = {c: [o for o in kept if o != c and _within(points, shells[c], shells[o])] for c in kept}
    bodies = [c for c in kept if len(depth[c]) % 2 == 0]
    if len(bodies) > 1:
        sizes = ", ".join(f"{abs(volume[c]):,.0f}" for c in bodies[:5])
        if keep != "largest":
            raise InputError(
                f"the surface encloses {len(bodies)} separate bodies of {sizes} mm^3; one is needed: join them or take "
                "the largest (domain.keep=largest)"
            )
        notes.append(f"the largest of {len(bodies)} bodies was taken")
    body = bodies[0]
    level = len(depth[body]) + 1
    chosen = [body, *(c for c in kept if body in depth[c] and len(depth[c]) == level)]
    if len(chosen) > 1:
        notes.append(f"{len(chosen) - 1} cavities inside the surface are outside the domain")
    outward = []
    for c in chosen:
        wanted = 1.0 if c == body else -1.0
        inward = volume[c] * wanted < 0.0
        if inward and c == body:
            notes.append("the normals of the surface pointed inward and were turned")
        outward.append(shells[c][:, ::-1] if inward else shells[c])
    used, index = np.unique(np.concatenate(outward), return_inverse=True)
    return points[used], index.reshape(-1, 3), notes


def _signed(triangle: np.ndarray) -> float:
    a, b, c = (triangle - triangle.reshape(-1, 3).mean(axis=0)).transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def _within(points: np.ndarray, shell: np.ndarray, other: np.ndarray) -> bool:
    """Whether a shell lies inside another, by a ray from one of its vertices in an odd direction."""
    corners = points[other]
    start = points[shell[0]].mean(axis=0)
    if (start < corners.min(axis=(0, 1))).any() or (start > corners.max(axis=(0, 1))).any():
        return False
    far = start + np.array([0.5773, 0.7071, 0.4082]) * 4.0 * float(np.ptp(corners, axis=(0, 1)).max())
    listed = np.arange(len(corners), dtype=np.int32)
    return bool(kernels.crossings(np.ascontiguousarray(corners), listed, *start, *far) % 2)

"""From a volume to a tree of vessels with sub-voxel centrelines and radii."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vascval.core.contraction import contract_degenerate
from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.imaging import graph
from vascval.imaging import runs as run_code
from vascval.imaging._geodesic_kernels import nearest_voxel
from vascval.imaging.breaks import Joined, join_breaks
from vascval.imaging.distance import distance_map
from vascval.imaging.first_guess import Refined
from vascval.imaging.graph import Branches, SkeletonGraph
from vascval.imaging.loops import Loops, open_loops
from vascval.imaging.memory import Budget, budget
from vascval.imaging.refine import draw, refine
from vascval.imaging.renewal import renew
from vascval.imaging.runs import Runs
from vascval.imaging.selection import select
from vascval.imaging.thinning import thin
from vascval.imaging.tips import Tips, find_tips, salience_mm
from vascval.imaging.voxels import Voxels, from_runs
from vascval.io.scans import Scan
from vascval.io.volumes import Volume

Observer = Callable[[str, float, float], None]
MOST_MASK_VOXELS = 2**27


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree and how it came out of its volume.

    * ``tree``: contracted, root first, curved centrelines, in the world frame of the volume.
    * ``image``: the record of what was selected, cleaned, cut and pruned; plain JSON values.
    * ``loops_mm`` (K, 3), ``spurs_mm`` (S, 3), ``breaks_mm`` (B, 3): where loops were cut, bumps passed over and torn
      vessels joined, world frame.
    """

    tree: Tree
    image: dict[str, Any]
    loops_mm: np.ndarray
    spurs_mm: np.ndarray
    breaks_mm: np.ndarray
    _runs: Runs
    _frame: Volume

    def mask(self, *, most_voxels: int = MOST_MASK_VOXELS) -> Volume:
        """The cleaned vessels as an image (uint8), cropped to them with a margin of one voxel where there is room.

        Where that has more than ``most_voxels``, in blocks of 2, 4, 8, ... voxels along each axis, a block being vessel
        when any of its voxels is; ``meta["block"]`` says how many.
        """
        runs, frame = self._runs, self._frame
        nz, ny, nx = runs.shape
        rows = np.flatnonzero(np.diff(runs.row_offset))
        low = np.array([runs.start.min(), (rows % ny).min(), (rows // ny).min()])
        high = np.array([runs.stop.max(), (rows % ny).max() + 1, (rows // ny).max() + 1])
        low, high = np.maximum(low - 1, 0), np.minimum(high + 1, [nx, ny, nz])
        block = 1
        while np.prod(-(-(high - low) // block)) > most_voxels:
            block *= 2
        values = run_code.painted(runs, low, high, block)
        origin = frame.to_world(low + (block - 1) / 2)
        return Volume(values, frame.spacing_mm * block, origin, frame.direction, {"block": block})


def skeletonize(
    volume: Volume | Scan,
    *,
    label: int | None = None,
    threshold: float | str | None = None,
    root_mm: tuple[float, float, float] | np.ndarray | None = None,
    max_memory_bytes: int | None = None,
    observer: Observer | None = None,
) -> Skeleton:
    """The tree of the vessels in a volume, in memory or read block by block: the same tree bit for bit.

    The steps: select the voxels; keep the largest component and the fragments that continue it; fill cavities; exact
    distance map; tips (:mod:`vascval.imaging.tips`); thinning towards the tips; a graph whose loops are opened at their
    thinnest vessel; root; sub-voxel refinement (:mod:`vascval.imaging.refine`); spurs; contraction of junctions that
    are one. All but the first work on the foreground alone, in time and memory O(foreground).

    :param label: value of the vessel's voxels; ``threshold``: least value, ``"auto"`` for Otsu's; see
        :func:`vascval.imaging.selection.select`.
    :param root_mm: point in the world frame where the vessel enters; by default the end of the thickest stem.
    :param max_memory_bytes: what the process may hold, the volume included; the memory of the machine by default.
    :param observer: called with the stage's name and how much is done.
    :raises InputError: when that is not enough (known before the work begins), nothing is selected, the vessel is too
        small to have a direction, or the root lies outside.
    """

    report = observer or (lambda stage, done, total: None)
    report("select", 0, 7)
    memory = budget(volume, max_memory_bytes)
    selection = select(volume, label=label, threshold=threshold, watch=memory.require_read)
    clean = _clean(selection.runs, volume.spacing_mm, memory, report)
    report("distance map", 2, 7)
    thickness = distance_map(clean.voxels)
    if not np.isfinite(thickness).all():
        raise InputError(
            "every voxel of the volume is vessel once cavities are filled; if the mask is inverted, choose its other "
            "value with --label"
        )
    report("tips", 3, 7)
    tips = find_tips(clean.voxels, thickness)
    root = None if root_mm is None else _root_voxel(volume, clean.voxels, tips, thickness, np.asarray(root_mm))
    report("thinning", 4, 7)
    left = thin(clean.voxels, thickness, tips.voxel if root is None else np.append(tips.voxel, root))
    report("graph", 5, 7)
    drawn = _draw(clean.voxels, left, thickness, tips, root)
    report("refinement", 6, 7)
    fitted = _fit(clean.voxels, drawn, thickness)
    tree = _tree(volume, fitted)
    whole = contract_degenerate(tree)
    report("done", 7, 7)

    def world(voxel: np.ndarray) -> np.ndarray:
        return volume.to_world(clean.voxels.index_xyz(voxel))

    spurs = np.concatenate((tips.spur, fitted.spur))
    image = {
        **_cleaning_record(clean),
        "n_spurs_pruned": int(spurs.size),
        "n_loops_cut": len(drawn.loops.cuts),
        "n_pinholes_opened": drawn.loops.n_pinholes,
        "n_junctions_contracted": tree.n_segments - whole.n_segments,
        "bump_mm": tips.bump_mm,
        "voxel_mm": volume.spacing_mm.tolist(),
        "selection": selection.rule,
        "notes": [*volume.meta.get("notes", ()), *_doubts(volume, clean.voxels.n, whole)],
    }
    frame = Volume(np.zeros((1, 1, 1), dtype=np.uint8), volume.spacing_mm, volume.origin_mm, volume.direction)
    loops_mm = world(drawn.skeleton.voxel[drawn.loops.cuts[:, 0]])
    breaks_mm = volume.to_world(clean.joined.breaks_xyz)
    return Skeleton(whole, image, loops_mm, world(spurs), breaks_mm, clean.runs, frame)


def _doubts(volume: Volume | Scan, n_voxels: int, tree: Tree) -> list[str]:
    """What makes one doubt that the voxels are vessels: a cast is a small part of its image, and made of tubes."""
    share = n_voxels / math.prod(volume.shape)
    described = tree.volume_mm3 / (n_voxels * float(np.prod(volume.spacing_mm)))
    doubts = []
    if share > 0.5:
        doubts.append(
            f"{share:.0%} of the image is taken for vessels; if the mask is inverted, choose its other value with "
            "--label"
        )
    if not 0.5 < described < 2.0:
        doubts.append(
            f"the vessels found have {described:.0%} of the volume of the voxels, so that these are hardly tubes: "
            "check that they are a cast"
        )
    return doubts


@dataclass(frozen=True, eq=False)
class _Clean:
    """The mask in one piece without cavities, and what was done to it."""

    runs: Runs
    voxels: Voxels
    component_voxels: np.ndarray
    joined: Joined
    n_cavities: int
    n_filled: int


def _clean(selected: Runs, spacing_mm: np.ndarray, memory: Budget, report: Observer) -> _Clean:
    report("clean", 1, 7)
    parts = run_code.components(selected)
    memory.require_all(selected.start.size, selected.n_voxels, int(parts.size_voxels[1:2].sum()))
    joined = join_breaks(selected, parts, spacing_mm)
    runs, n_cavities, n_filled = run_code.fill_cavities(joined.runs)
    return _Clean(runs, from_runs(runs, spacing_mm), parts.size_voxels, joined, n_cavities, n_filled)


def _cleaning_record(clean: _Clean) -> dict[str, Any]:
    return {
        "n_components": int(clean.component_voxels.size),
        "largest_component_fraction": float(clean.component_voxels[0] / clean.component_voxels.sum()),
        "component_voxels": clean.component_voxels[:10].tolist(),
        "n_voxels": clean.voxels.n,
        "n_breaks_joined": len(clean.joined.breaks_xyz),
        "n_voxels_left_out": clean.joined.n_voxels_left,
        "n_cavities_filled": clean.n_cavities,
        "n_voxels_filled": clean.n_filled,
    }


def _root_voxel(volume: Volume | Scan, voxels: Voxels, tips: Tips, thickness: np.ndarray, root_mm: np.ndarray) -> int:
    """The voxel where the vessel is to enter: the tip nearest to the given point if it is within two radii of it."""
    if root_mm.shape != (3,) or not np.isfinite(root_mm).all():
        raise InputError(f"root {root_mm.tolist()} is no point; three finite numbers x, y, z in mm are needed")
    point = volume.to_index(root_mm) * voxels.spacing_mm
    nearest, away = nearest_voxel(point, voxels.lattice, voxels.spacing_mm)
    if away > 2 * voxels.spacing_mm.max():
        where = ", ".join(f"{value:.2f}" for value in volume.to_world(voxels.index_xyz(nearest)))
        raise InputError(
            f"root {', '.join(f'{value:g}' for value in root_mm)} lies {away:.2f} mm outside the vessels; "
            f"give a point on them in the world frame (mm), the nearest is {where}"
        )
    to_tip = np.sqrt(((voxels.index_xyz(tips.voxel) * voxels.spacing_mm - point) ** 2).sum(axis=1))
    tip = int(np.argmin(to_tip))
    near = to_tip[tip] <= 2 * (thickness[nearest] + voxels.spacing_mm.max())
    return int(tips.voxel[tip]) if near else nearest


@dataclass(frozen=True, eq=False)
class _Drawn:
    """The skeleton with its root, the ends of vessels among its points and the judgement of its loops."""

    skeleton: SkeletonGraph
    order: np.ndarray
    parent: np.ndarray
    ends: np.ndarray
    loops: Loops


def _draw(voxels: Voxels, left: np.ndarray, thickness: np.ndarray, tips: Tips, root_voxel: int | None) -> _Drawn:
    skeleton = graph.spanning_skeleton(voxels, left, thickness)
    ends = np.searchsorted(skeleton.voxel, tips.voxel)
    if ends.size < 2:
        raise InputError("the selected voxels have no two ends: they are a lump and not a vessel; check the selection")
    known = ends if root_voxel is None else np.union1d(ends, np.searchsorted(skeleton.voxel, root_voxel))
    position = voxels.index_xyz(skeleton.voxel) * voxels.spacing_mm
    at = thickness[skeleton.voxel]
    skeleton, loops = open_loops(skeleton, known, position, at, salience_mm(at, tips.bump_mm))
    if root_voxel is None:
        root = graph.thickest_end(skeleton, ends, thickness)
    else:
        root = int(np.searchsorted(skeleton.voxel, root_voxel))
    order, parent = graph.rooted(skeleton, root)
    ends = np.union1d(ends[ends != root], loops.stub)
    return _Drawn(skeleton, order, parent, ends, loops)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """``branches`` and their ``geometry``; ``spur``: voxels of the tips that did not stick out of their parent."""

    branches: Branches
    geometry: Refined
    spur: np.ndarray


def _fit(voxels: Voxels, drawn: _Drawn, thickness: np.ndarray) -> _Fitted:
    """Draw, drop the terminals that end inside the vessel they spring from until none does, refine, and drop those
    that are seen only now, refining there."""
    ends, voxel = drawn.ends, drawn.skeleton.voxel
    spurs: list[int] = []
    tree = graph.branches(drawn.order, drawn.parent, ends)
    geometry, is_refined = draw(voxels, tree, voxel, thickness), False
    while True:
        spur = _spurs(tree, geometry)
        if 0 < spur.size < ends.size:
            gone = tree.last[spur]
            spurs.extend(gone.tolist())
            ends = np.setdiff1d(ends, gone)
            before, tree = tree, graph.branches(drawn.order, drawn.parent, ends)
            if is_refined:
                geometry = renew(voxels, tree, voxel, thickness, before, geometry)
            else:
                geometry = draw(voxels, tree, voxel, thickness)
        elif is_refined:
            return _Fitted(tree, geometry, voxel[np.array(spurs, dtype=np.int64)])
        else:
            geometry, is_refined = refine(voxels, tree, geometry), True


def _spurs(tree: Branches, geometry: Refined) -> np.ndarray:
    """Terminal branches whose tip lies within the radius of the thickest vessel at their junction."""
    n_children = np.bincount(tree.parent + 1, minlength=tree.n + 1)
    at = tree.parent + 1
    thickest = np.zeros(tree.n + 1)
    np.maximum.at(thickest, at, geometry.radius_mm)
    thickest[1:] = np.maximum(thickest[1:], geometry.radius_mm)
    reach = np.sqrt(((geometry.node_mm[1:] - geometry.node_mm[at]) ** 2).sum(axis=1))
    branching = n_children[at] > 1
    return np.flatnonzero((n_children[1:] == 0) & branching & (reach <= thickest[at]))


def _tree(volume: Volume | Scan, fitted: _Fitted) -> Tree:
    """The refined branches in the world frame of the volume."""
    geometry = fitted.geometry
    point = volume.to_world(geometry.point_mm / volume.spacing_mm)
    node = np.concatenate((point[:1], point[geometry.offset[1:] - 1]))
    return Tree(
        Topology(np.concatenate(([-1], fitted.branches.parent + 1)).astype(np.int32)),
        node,
        np.concatenate(([0.0], geometry.radius_mm)),
        {"radius_sd_mm": np.concatenate(([0.0], geometry.radius_sd_mm))},
        point,
        np.concatenate(([0], geometry.offset)),
    )

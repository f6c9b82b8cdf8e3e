"""Sub-voxel centrelines, junctions, tips and radii from all voxels of each branch.

A chain of voxels runs up to a voxel off the axis, and its distance values are half a voxel and more too small. Here
every foreground voxel is given to a branch (least power distance) and its cross-section; the centreline runs through
the centroids of the cross-sections, away from the junctions; a junction lies where the straight continuations of its
branches come closest; a tip where the volume beyond the last full cross-section puts it; and a radius is a mean over
all directions and sections, which neither the voxel grid nor a rough surface biases.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vascval.imaging import _graph_kernels
from vascval.imaging import _refine_kernels as kernels
from vascval.imaging.first_guess import Nodes, Refined, first_guess
from vascval.imaging.graph import Branches
from vascval.imaging.voxels import Voxels

ROUNDS = 3
SECTION_VOXELS = 1.0
SMOOTHING_RADII = 2.0
MIN_WINDOW = 0.15
MAX_SHIFT_RADII = 1.0
BEND_T = 3.0


@dataclass(frozen=True, eq=False)
class _Stations:
    """Cross-sections along the branches and the voxels that lie in them; see the kernels' module."""

    offset: np.ndarray
    position: np.ndarray
    tangent: np.ndarray
    arc: np.ndarray
    branch: np.ndarray
    of_voxel: np.ndarray
    along: np.ndarray
    count: np.ndarray
    total: np.ndarray

    @property
    def length(self) -> np.ndarray:
        """(s,) length of each branch."""
        return self.arc[self.offset[1:] - 1]


@dataclass(frozen=True, eq=False)
class _Fit:
    """Straight lines at the two ends of each branch, (s, 2, ...): 0 proximal, 1 distal."""

    centre: np.ndarray
    direction: np.ndarray
    weight: np.ndarray


def draw(voxels: Voxels, tree: Branches, skeleton_voxel: np.ndarray, thickness_mm: np.ndarray) -> Refined:
    """The first guess for a whole tree of voxel chains.

    :param skeleton_voxel: (k,) voxel of each skeleton point.
    :param thickness_mm: (n,) distance map.
    """
    chains = [tree.chain(b) for b in range(tree.n)]
    return first_guess(voxels, _nodes(tree), chains, skeleton_voxel, thickness_mm)


def refine(voxels: Voxels, tree: Branches, drawn: Refined) -> Refined:
    """Refine a tree that was drawn by :func:`draw`."""
    return rounds(voxels, _nodes(tree), drawn, np.full(voxels.n, -1, dtype=np.int32), tree.last)


def _nodes(tree: Branches) -> Nodes:
    fixed, clear_mm = np.zeros(tree.n + 1, dtype=bool), np.zeros((tree.n, 2))
    return Nodes(tree.parent.astype(np.int64) + 1, np.arange(tree.n) + 1, fixed, clear_mm)


def rounds(voxels: Voxels, nodes: Nodes, drawn: Refined, label: np.ndarray, last: np.ndarray) -> Refined:
    """Improve a first guess ``ROUNDS`` times.

    :param label: (n,) int32, overwritten: -1 for the voxels that may belong to these branches, and ``-2 - owner`` for
        others.
    :param last: the skeleton point in which each branch ends.
    """
    now = drawn
    for _ in range(ROUNDS):
        stations = _stations(voxels, now, label)
        now = _improve(voxels, nodes, now, drawn, stations)
        branch = stations.branch
        del stations  # makes room for those of the next round
    kernels.name_owners(label, last.astype(np.int32)[branch])
    return replace(now, owner=label)


def _stations(voxels: Voxels, now: Refined, label: np.ndarray) -> _Stations:
    """Cross-sections every voxel along the branches, and for each voxel the one of least power distance.

    :param label: as in :func:`rounds`, or the outcome of the round before; overwritten by the stations.
    """
    step = SECTION_VOXELS * float(voxels.spacing_mm.min())
    offset, position, tangent, arc, branch = kernels.make_stations(now.point_mm, now.offset, step, now.radius_mm)
    kernels.reopen(label)
    at = voxels.find(np.rint(position / voxels.spacing_mm).astype(np.int64))
    seed = np.flatnonzero((at >= 0) & (label[at] == -1))
    label[at[seed]] = seed
    grid = (voxels.lattice, voxels.spacing_mm)
    _graph_kernels.nearest_points(label, position, now.radius_mm[branch], *grid, np.full(voxels.n, np.inf))
    along = kernels.relocate(label, branch, offset, position, tangent, arc, *grid)
    count, total = kernels.centroids(label, arc.size, *grid)
    return _Stations(offset, position, tangent, arc, branch, label, along, count, total)


def _improve(voxels: Voxels, nodes: Nodes, now: Refined, drawn: Refined, stations: _Stations) -> Refined:
    """One round from the geometry ``now``, ``drawn`` being the first guess.

    Windows clear of the junctions, lines through them, nodes where the lines meet, centrelines, radii.
    """
    low, high = _windows(nodes, stations, _clearance(nodes, now, _outward(now, stations)))
    lines = _lines(nodes, now, stations, low, high)
    clear = _clearance(nodes, now, _outward(now, stations, lines))
    low, high = _windows(nodes, stations, clear)
    lines = _lines(nodes, now, stations, low, high)
    radius = _radii(voxels, nodes, now, drawn.radius_mm, stations, low, high)
    node = np.where(nodes.fixed[:, None], now.node_mm, _solve_nodes(nodes, now, lines, drawn.node_mm))
    _place_tips(voxels, nodes, stations, lines, radius, low, high, node)
    width = SMOOTHING_RADII * np.maximum(radius, float(voxels.spacing_mm.max()))
    centre = kernels.smooth_centres(
        stations.count, stations.total, stations.offset, stations.position, stations.tangent, stations.arc,
        low, high, width,
    )  # fmt: skip
    point, offset = _assemble(nodes, stations, centre, node, lines, low, high)
    return Refined(node, point, offset, radius, _radius_scatter(voxels, stations, low, high), clear, now.owner)


def _outward(now: Refined, stations: _Stations, lines: _Fit | None = None) -> np.ndarray:
    """(s, 2, 3) unit directions that leave each branch's two nodes along the branch."""
    middle = (stations.offset[:-1] + stations.offset[1:]) // 2
    chord = np.stack((stations.position[middle] - stations.position[stations.offset[:-1]],
                      stations.position[middle] - stations.position[stations.offset[1:] - 1]), axis=1)  # fmt: skip
    size = np.sqrt((chord**2).sum(axis=2, keepdims=True))
    direction = np.where(size > 0, chord / np.maximum(size, 1e-300), np.array([1.0, 0.0, 0.0]))
    if lines is not None:
        good = lines.weight > 0
        direction[good] = (lines.direction * np.array([1.0, -1.0])[None, :, None])[good]
    return direction


def _clearance(nodes: Nodes, now: Refined, outward: np.ndarray) -> np.ndarray:
    """(s, 2) how far from its two nodes each branch comes clear of the other branches there, or of a rounded tip."""
    before, after = np.zeros(nodes.n_branches), np.zeros(nodes.n_branches)
    kernels.clearance(outward, now.radius_mm, nodes.offset, nodes.branch, nodes.end, before, after)
    ends = np.stack((nodes.proximal, nodes.distal), axis=1)
    clear = np.where(nodes.tip[ends], now.radius_mm[:, None], np.stack((before, after), axis=1))
    return np.where(nodes.fixed[ends], nodes.clear_mm, clear)


def _windows(nodes: Nodes, stations: _Stations, clear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s,), (s,) the stretch of arc length of each branch that is clear of junctions and rounded tips.

    Where a branch is too short for that, at least ``MIN_WINDOW`` of its length about the middle of what is clear.
    """
    length = stations.length
    excess = clear.sum(axis=1) / np.maximum((1 - MIN_WINDOW) * length, 1e-300)
    before, after = (clear / np.maximum(1.0, excess)[:, None]).T
    return before, length - after


def _lines(nodes: Nodes, now: Refined, stations: _Stations, low: np.ndarray, high: np.ndarray) -> _Fit:
    """Lines through the sections next to each junction, as long as the vessels there are thick."""
    thickest = nodes.thickest(now.radius_mm)
    parts = []
    for at_end, node in ((False, nodes.proximal), (True, nodes.distal)):
        reach = np.maximum(4.0 * now.radius_mm, 2.0 * thickest[node])
        parts.append(
            kernels.end_lines(
                stations.count, stations.total, stations.offset, stations.arc, low, high, reach, at_end, BEND_T
            )
        )
    centre, direction, weight = (np.stack(pair, axis=1) for pair in zip(*parts))
    return _Fit(centre, direction, weight)


def _solve_nodes(nodes: Nodes, now: Refined, lines: _Fit, drawn_mm: np.ndarray) -> np.ndarray:
    """Junctions as the points closest, in weighted least squares, to the lines that meet there.

    Lines at an acute angle may meet far away: no junction moves farther than ``MAX_SHIFT_RADII`` times the thickest
    radius there from where it was drawn, ``drawn_mm``.
    """
    matrix = np.zeros((nodes.n, 3, 3))
    right = np.zeros((nodes.n, 3))
    total = np.zeros(nodes.n)
    for end, node in ((0, nodes.proximal), (1, nodes.distal)):
        d, weight = lines.direction[:, end], lines.weight[:, end] ** 2
        across = weight[:, None, None] * (np.eye(3) - d[:, :, None] * d[:, None, :])
        np.add.at(matrix, node, across)
        np.add.at(right, node, np.einsum("nij,nj->ni", across, lines.centre[:, end]))
        np.add.at(total, node, weight)
    # a little pull to where the node was settles what parallel lines leave open
    pull = np.where(total > 0, 0.01 * total, 1.0)
    matrix += pull[:, None, None] * np.eye(3)
    right += pull[:, None] * now.node_mm
    solved = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    shift = solved - drawn_mm
    size = np.sqrt((shift**2).sum(axis=1))
    allowed = MAX_SHIFT_RADII * nodes.thickest(now.radius_mm)
    return drawn_mm + shift * np.minimum(1.0, allowed / np.maximum(size, 1e-300))[:, None]


def _place_tips(
    voxels: Voxels,
    nodes: Nodes,
    stations: _Stations,
    lines: _Fit,
    radius: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    node: np.ndarray,
) -> None:
    """Put the ends of terminals and stem where the volume beyond the last full section places them.

    The volume beyond a section, divided by the area of the cross-section before it, tells how long a flat-ended vessel
    would go on; a hemisphere at the end holds as much as two thirds of a radius of it, and the centreline ends in the
    hemisphere's centre. A vessel that leaves the volume ends where it leaves.
    """
    step = SECTION_VOXELS * float(voxels.spacing_mm.min())
    cell = float(np.prod(voxels.spacing_mm))
    reach = np.maximum(np.minimum(4.0 * radius, high - low), 1e-9)
    for end, of_branch, limit, sign in ((0, nodes.proximal, low, -1), (1, nodes.distal, high, 1)):
        tip = nodes.tip[of_branch]
        signs = np.where(tip, sign, 0)
        voxel_of = (stations.along, stations.of_voxel, stations.branch)
        beyond = kernels.voxels_beyond(*voxel_of, limit, signs, 2.0 * step) * cell
        area = kernels.voxels_beyond(*voxel_of, limit - sign * reach, signs, 2.0 * step) * cell - beyond
        area = np.where(area > 0, area / reach, np.pi * radius**2)
        nz, _, nx = voxels.shape
        cut = kernels.reaches_border(*voxel_of, limit, signs, voxels.lattice, nx, nz)
        further = beyond / area - np.where(cut, 0.0, 2.0 * np.sqrt(area / np.pi) / 3.0)
        branch = np.flatnonzero(tip & (lines.weight[:, end] > 0))
        if branch.size == 0:
            continue
        direction, centre = lines.direction[branch, end], lines.centre[branch, end]
        section = np.array([_point_at(stations, b, limit[b]) for b in branch.tolist()])
        along = ((section - centre) * direction).sum(axis=1) + sign * np.maximum(0.0, further[branch])
        place = centre + along[:, None] * direction
        # a stub too short for a direction of its own may point out of the vessel: there the drawn end stays
        inside = (voxels.find(np.rint(place / voxels.spacing_mm)) >= 0) | cut[branch]
        node[of_branch[branch[inside]]] = place[inside]


def _point_at(stations: _Stations, branch: int, arc: float) -> np.ndarray:
    own = slice(stations.offset[branch], stations.offset[branch + 1])
    return np.array([np.interp(arc, stations.arc[own], stations.position[own, k]) for k in range(3)])


def _radii(
    voxels: Voxels,
    nodes: Nodes,
    now: Refined,
    coarse: np.ndarray,
    stations: _Stations,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """(s,) mean radius of each branch over all directions and sections between ``low`` and ``high``.

    With the axis as origin, the integral of ``dV / rho`` over a stretch of length L is that of ``r(theta, s)`` over
    angle and arc length, 2 pi L times the mean radius: a linear functional of the mask, so that neither voxels nor
    roughness bias it, as they do the distance map (towards thin) and the square root of the area (towards thick).
    Voxels near the axis are integrated over instead of sampled, which by the divergence theorem leaves out a flux
    through the rim of ``h^2 / (24 rho)`` for voxels of edge h; it is added again. The ends of the stretch are tapered.
    A branch that shows less than one section of its own (a piece inside a junction) keeps the ``coarse`` radius of the
    distance map.
    """
    step = SECTION_VOXELS * float(voxels.spacing_mm.min())
    cell = float(np.prod(voxels.spacing_mm))
    window = high - low
    ramp = np.maximum(np.minimum(0.5 * window, np.maximum(2.0 * step, 0.25 * window)), 1e-9)
    near = 2.0 * float(voxels.spacing_mm.max())
    total = kernels.section_sums(
        stations.of_voxel, stations.along, stations.branch, stations.position, stations.tangent,
        low, high, ramp, near, voxels.lattice, voxels.spacing_mm,
    )  # fmt: skip
    radius = total * cell / (2.0 * np.pi * np.maximum(window - ramp, 1e-9))
    chord = now.node_mm[nodes.distal] - stations.position[stations.offset[:-1]]
    share = chord**2 / np.maximum((chord**2).sum(axis=1, keepdims=True), 1e-300)
    across = ((1.0 - share) * voxels.spacing_mm**2).sum(axis=1) / 2.0
    radius += across / (24.0 * np.clip(radius, 0.5 * step, near))
    seen = (window - ramp > step) & (radius > 0.5 * coarse)
    return np.where(seen, radius, coarse)


def _radius_scatter(voxels: Voxels, stations: _Stations, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(s,) standard deviation, along each branch, of the radius of equal area of its sections."""
    n = low.size
    pitch = stations.length / np.maximum(np.diff(stations.offset) - 1, 1)
    inside = (stations.arc >= low[stations.branch]) & (stations.arc <= high[stations.branch]) & (stations.count > 0)
    of = stations.branch[inside]
    area = stations.count[inside] * float(np.prod(voxels.spacing_mm)) / np.maximum(pitch[of], 1e-9)
    section = np.sqrt(area / np.pi)
    count = np.maximum(np.bincount(of, minlength=n), 1)
    mean = np.bincount(of, weights=section, minlength=n) / count
    return np.sqrt(np.bincount(of, weights=(section - mean[of]) ** 2, minlength=n) / count)


def _assemble(
    nodes: Nodes,
    stations: _Stations,
    centre: np.ndarray,
    node: np.ndarray,
    lines: _Fit,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Polylines: proximal node, the smoothed centres inside the window, distal node.

    Centres that lie behind a node that has moved are left out, so that no centreline runs back and forth.
    """
    branch = stations.branch
    start, end = node[nodes.proximal][branch], node[nodes.distal][branch]
    ahead = ((centre - start) * lines.direction[:, 0][branch]).sum(axis=1) > 0
    behind = ((end - centre) * lines.direction[:, 1][branch]).sum(axis=1) > 0
    early = stations.arc < 0.5 * stations.length[branch]
    inside = (stations.arc > low[branch]) & (stations.arc < high[branch]) & (stations.count > 0)
    inside &= np.where(early, ahead, behind)
    n = nodes.n_branches
    of = np.concatenate((branch[inside], np.arange(n), np.arange(n)))
    key = np.concatenate((stations.arc[inside], np.full(n, -np.inf), np.full(n, np.inf)))
    point = np.concatenate((centre[inside], node[nodes.proximal], node[nodes.distal]))
    order = np.lexsort((key, of))
    offset = np.concatenate(([0], np.cumsum(np.bincount(of, minlength=n))))
    return point[order], offset.astype(np.int64)

"""A tree that has lost a branch is refined there alone, and comes out as if all of it had been refined."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.phantoms import phantom
from vascval.imaging import graph
from vascval.imaging import runs as run_code
from vascval.imaging.distance import distance_map
from vascval.imaging.refine import draw, refine
from vascval.imaging.renewal import renew
from vascval.imaging.selection import select
from vascval.imaging.thinning import thin
from vascval.imaging.tips import find_tips
from vascval.imaging.voxels import from_runs


@pytest.mark.parametrize("kind", ["smooth", "trifurcating"])
def test_renewed_branches_are_those_of_a_whole_refinement(kind: str) -> None:
    case = phantom(kind, 3, size=200, n_terminals=60)
    runs = select(case.volume).runs
    parts = run_code.components(runs)
    runs = run_code.keep(runs, parts.label, np.arange(parts.size_voxels.size) == 0)
    voxels = from_runs(runs, case.volume.spacing_mm)
    thickness = distance_map(voxels)
    tips = find_tips(voxels, thickness)
    rng = np.random.default_rng(0)
    wall = rng.choice(np.flatnonzero(thickness == 1.0), 6, replace=False)
    left = thin(voxels, thickness, np.append(tips.voxel, wall))
    skeleton = graph.spanning_skeleton(voxels, left, thickness)
    ends = np.searchsorted(skeleton.voxel, tips.voxel)
    order, parent = graph.rooted(skeleton, graph.thickest_end(skeleton, ends, thickness))
    tree = graph.branches(order, parent, ends)
    whole = refine(voxels, tree, draw(voxels, tree, skeleton.voxel, thickness))
    for bump in np.searchsorted(skeleton.voxel, wall):
        before = graph.branches(order, parent, np.append(ends, bump))
        known = refine(voxels, before, draw(voxels, before, skeleton.voxel, thickness))
        assert before.n > tree.n
        found = renew(voxels, tree, skeleton.voxel, thickness, before, known)
        assert found.offset[-1] == len(found.point_mm)
        assert np.array_equal(found.point_mm[found.offset[1:] - 1], found.node_mm[1:])
        away = np.linalg.norm(found.node_mm - whole.node_mm, axis=1)[1:] / whole.radius_mm
        assert np.median(away) < 1e-3
        assert away.max() < 0.15
        assert np.abs(found.radius_mm / whole.radius_mm - 1).max() < 0.01
        # each voxel that has changed hands belongs to a branch that there is
        assert np.isin(found.owner, tree.last).all()
        old = np.full(skeleton.voxel.size, -1)
        old[before.last] = np.arange(before.n)
        kept = found.radius_mm == known.radius_mm[old[tree.last]]
        assert 0 < np.count_nonzero(~kept) <= 10

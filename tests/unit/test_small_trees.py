"""Whole runs of a dozen terminals: every way to grow, search and optimise, each tree checked against its laws.

They are so small that they also run without the compiler, where branches of kernels are counted.
"""

import numpy as np
import pytest

from generator.config import load
from generator.framework import Run
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Topology, Tree
from vascval.core.validation import require_made_well
from vascval.io.trees import write_tree
from vascval.io.volumes import Volume, write_volume
from vascval.morphometry.overlaps import overlapping_pairs

POINTS = np.vstack([[1.0, 1, 1], np.random.default_rng(4).random((9, 3)) * (88, 68, 14) + 1])
ELL_ROOT = "root_mm=10,55,10"  # at the end of one leg


def in_the_ell(points: np.ndarray) -> np.ndarray:
    """Within one of the two blocks of 60 x 20 x 20 mm that meet at a right angle; to rounding."""
    blocks = np.array([[60, 20, 20], [20, 60, 20]]) + 1e-9
    return ((points[:, None] >= -1e-9) & (points[:, None] <= blocks)).all(axis=2).any(axis=1)


@pytest.fixture(scope="module", name="folder")
def _folder(tmp_path_factory):
    """The files that configurations name: terminals, a root tree, an L-shaped domain as voxels and as a surface."""
    folder = tmp_path_factory.mktemp("small")
    np.savetxt(folder / "points.csv", POINTS, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    position = np.array([[1.0, 1, 8], [20, 20, 8], [30, 40, 8], [45, 15, 8]])
    radius = np.array([1.6, 1.6, 1.25, 1.25])
    write_tree(Tree(Topology(np.array([-1, 0, 1, 1], np.int32)), position, radius), folder / "root.vtp")
    values = np.zeros((4, 12, 12), np.uint8)
    values[:, :4, :] = values[:, :, :4] = 1
    write_volume(Volume(values, np.full(3, 5.0), np.full(3, 2.5)), folder / "ell.nrrd")
    outline = [(0, 0), (60, 0), (60, 20), (20, 20), (20, 60), (0, 60)]
    corners = [f"v {x} {y} {z}" for z in (0, 20) for x, y in outline]
    floor = [(1, 2, 3), (1, 3, 4), (1, 4, 5), (1, 5, 6)]
    faces = [(a, c, b) for a, b, c in floor] + [(a + 6, b + 6, c + 6) for a, b, c in floor]
    for k in range(6):
        a, b = k + 1, (k + 1) % 6 + 1
        faces += [(a, b, b + 6), (a, b + 6, a + 6)]
    (folder / "ell.obj").write_text("\n".join([*corners, *(f"f {a} {b} {c}" for a, b, c in faces)]) + "\n")
    return folder


def made(folder, *changes) -> tuple[Run, Tree]:
    run = Run.of(load("karch-box", ["n_terminals=12", *(change.format(folder=folder) for change in changes)]))
    for _ in run.steps():
        pass
    tree = run.tree()
    require_made_well(tree, run.claims(tree))
    return run, tree


GEOMETRY, FULL = ("method=geometry", "geometry.every=5"), ("method=full", "topology.at=8", "topology.tests=60")
SURFACE, VOXELS = ("domain.file={folder}/ell.obj", ELL_ROOT), ("domain.file={folder}/ell.nrrd", ELL_ROOT)
GIVEN = "terminals_file={folder}/points.csv"
ROUNDS = "topology.rounds=2"
ROOT_TREE = "root_tree={folder}/root.vtp"


@pytest.mark.parametrize(
    "changes",
    [
        (),
        ("growth.merge_mm=8",),
        ("growth.l_min_mm=2", "n_connections=3"),
        (GIVEN,),
        (GIVEN, "terminals_order=random", "growth.merge_mm=3"),
        (GIVEN, "terminals_order=given", "growth.avoid_intersections=true"),
        (ROOT_TREE,),
        (*GEOMETRY,),
        (*GEOMETRY, "geometry.during_growth=false", "geometry.contract=false", "geometry.split=false"),
        (*GEOMETRY, "geometry.solver=ipopt"),
        (*GEOMETRY, "geometry.gamma_by_generation=2.5,2.6,2.7"),
        (*GEOMETRY, "viscosity=fahraeus-lindqvist"),
        (*GEOMETRY, "geometry.objective=volume+power"),
        (*GEOMETRY, "growth.avoid_intersections=true", "perfusion.flow_ml_min=2000"),
        (*GEOMETRY, ROOT_TREE),
        (*FULL, "topology.swaps=0.5"),
        (*FULL, ROOT_TREE),
        (*FULL, ROUNDS),
        (*FULL, ROUNDS, ROOT_TREE),
    ],
    ids=lambda changes: " ".join(changes).replace("{folder}/", "") or "plain",
)
def test_a_tree_of_a_dozen_holds_its_laws(folder, changes):
    run, tree = made(folder, *changes)
    ends = tree.position_mm[tree.topology.terminals]
    assert len(ends) == (len(POINTS) - 1 if GIVEN in changes else 12)
    if GIVEN in changes:
        expected = POINTS[1:]
        np.testing.assert_array_equal(ends[np.lexsort(ends.T)], expected[np.lexsort(expected.T)])
    if ROOT_TREE in changes:
        np.testing.assert_array_equal(tree.radius_mm[1:4], [1.6, 1.25, 1.25])
    if "growth.avoid_intersections=true" in changes:
        assert len(overlapping_pairs(tree)) == 0
    assert run.domain.contains(tree.position_mm).all()


@pytest.mark.parametrize("domain", [SURFACE, VOXELS], ids=["surface", "voxels"])
@pytest.mark.parametrize("method", [(), GEOMETRY, FULL, (*FULL, ROUNDS)], ids=["cco", "geometry", "full", "rounds"])
def test_nothing_crosses_the_inner_corner(folder, domain, method):
    _, tree = made(folder, *domain, *method)
    along = np.linspace(0.0, 1.0, 50)[:, None, None]
    start, end = tree.position_mm[tree.parent[1:]], tree.position_mm[1:]
    assert in_the_ell((start + along * (end - start)).reshape(-1, 3)).all()
    assert (tree.position_mm[tree.topology.terminals, 0] > 25).any()  # round the corner from the root


def test_growth_ends_or_fails_at_the_thinnest_radius(folder):
    thin = "growth.r_min_mm=0.45"
    run, tree = made(folder, "n_terminals=60", thin, "growth.at_r_min=stop")
    assert run.growth.stopped_at_thinnest
    assert 12 < tree.topology.n_terminals < 60
    with pytest.raises(ComputationError, match="r_min"):
        made(folder, "n_terminals=60", thin)


THICK = ("growth.avoid_intersections=true", "perfusion.flow_ml_min=100000")


@pytest.mark.parametrize("changes", [("n_terminals=12",), ("n_terminals=40", "perfusion.flow_ml_min=40000", "seed=2")])
def test_vessels_that_came_to_overlap_are_grown_anew(folder, changes):
    run, tree = made(folder, *THICK, *changes)
    assert run.growth.state()["progress"][1] > 0  # it did happen here
    assert tree.topology.n_terminals == run.config.n_terminals
    assert len(overlapping_pairs(tree)) == 0


def test_vessels_that_are_too_thick_are_refused(folder):
    with pytest.raises(InputError, match="terminals cannot be joined to the tree by straight vessels that keep apart"):
        made(folder, GIVEN, *THICK, "perfusion.flow_ml_min=2000000")
    with pytest.raises(ComputationError, match="the root tree uses up the pressure before its ends"):
        made(folder, ROOT_TREE, *THICK)


@pytest.mark.parametrize("kept_at", ["growth", "topology", "geometry"])
def test_a_small_run_goes_on_from_where_it_was_kept(folder, kept_at):
    changes = ("n_terminals=8", "method=full", "topology.at=6", "topology.tests=30", "geometry.every=1")
    whole, expected = made(folder, *changes)
    first, again = (Run.of(whole.config) for _ in range(2))
    state = next(first.state() for name, _ in first.steps() if name == kept_at)
    again.restore(state)
    for _ in again.steps():
        pass
    for name in ("parent", "position_mm", "radius_mm"):
        np.testing.assert_array_equal(getattr(again.tree(), name), getattr(expected, name))
    assert again.topology.history[-1].n_tests == 30

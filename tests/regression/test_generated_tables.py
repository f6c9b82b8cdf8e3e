"""Small trees of each method, and each phantom found in its image, by generation, as when they were last looked at.

``VASCVAL_UPDATE_TABLES=1 pytest tests/regression`` writes the tables anew. How far a number may move though nothing
has changed was measured by changing the height of the box, or the flow, by 1 to 4 parts in 10^13: as much as the
rounding of another machine would.
"""

import pandas as pd
import pytest

from generator.config import load
from generator.framework import Run
from tests.benchmarks.phantoms import KINDS, phantom
from tests.regression.golden import check
from vascval.imaging import skeletonize
from vascval.morphometry import analyze

METHODS = {
    # growth compares volumes, which differ by far more than they are rounded: counts stay; positions of bifurcations
    # are iterated to about 1e-6 of a length (measured: numbers move by up to 5e-6)
    "cco": 2e-5,
    # measured 2e-13; where an iteration stops may depend on rounding, and its tolerance is 1e-5 or less
    "geometry": 2e-5,
    # a long search on twelve terminals ends at the same topology, whatever its path; then as geometry
    "full": 2e-5,
}
SEARCH = ("topology.at=12", "topology.tests=20000", "topology.chains=2")
GENERATIONS = [
    "generation", "order", "n_segments", "n_elements", "radius_mean_mm", "radius_sd_mm", "length_mean_mm",
    "length_sd_mm", "branching_ratio_mean", "n_trifurcations", "n_monopodial",
]  # fmt: skip


def by_generation(tree, **options):
    """Counts, sizes and ratios of each generation, and Horton's ratios below them."""
    analysis = analyze(tree, source="x", **options)
    table = analysis.generations[GENERATIONS]
    ratios = analysis.horton[analysis.horton["ordering"] == "strahler"]
    return table, ratios[["quantity", "ratio", "r_squared", "n_orders"]]


@pytest.mark.parametrize("preset", ["karch-box", "portal-vein"])
@pytest.mark.parametrize("method", METHODS)
def test_grown_trees(method, preset):
    run = Run.of(load(preset, [f"method={method}", "n_terminals=150", *SEARCH]))
    for _ in run.steps():
        pass
    generations, ratios = by_generation(run.tree())
    check(generations, f"{preset}_{method}_generations", rtol=METHODS[method])
    check(ratios, f"{preset}_{method}_horton", rtol=METHODS[method])


@pytest.mark.parametrize("kind", KINDS)
def test_phantoms(kind):
    """Images are the same to the voxel but for the rough one, whose noise is rounded in single precision: there a
    voxel in some thousand may change sides."""
    found = skeletonize(phantom(kind, 0, size=160, n_terminals=30).volume)
    generations, ratios = by_generation(found.tree, image=found.image)
    rtol = 1e-3 if kind == "rough" else 1e-6
    check(generations, f"phantom_{kind}_generations", rtol=rtol)
    check(ratios, f"phantom_{kind}_horton", rtol=rtol)


def test_a_table_that_moved_is_noticed(tmp_path, monkeypatch):
    table = pd.DataFrame({"generation": [1, 2], "radius_mean_mm": [2.0, 1.0]})
    monkeypatch.setenv("VASCVAL_UPDATE_TABLES", "1")
    monkeypatch.delenv("CI", raising=False)
    check(table, "x", folder=tmp_path)
    monkeypatch.delenv("VASCVAL_UPDATE_TABLES")
    check(table * [1, 1 + 1e-9], "x", folder=tmp_path)
    with pytest.raises(AssertionError, match="radius_mean_mm"):
        check(table * [1, 1 + 1e-7], "x", folder=tmp_path)
    with pytest.raises(AssertionError, match="generation"):
        check(pd.concat([table, table]), "x", folder=tmp_path)
    with pytest.raises(AssertionError, match="not there"):
        check(table, "y", folder=tmp_path)


def test_continuous_integration_writes_no_table(tmp_path, monkeypatch):
    monkeypatch.setenv("VASCVAL_UPDATE_TABLES", "1")
    monkeypatch.setenv("CI", "true")
    with pytest.raises(AssertionError, match="does not write"):
        check(pd.DataFrame({"generation": [1]}), "x", folder=tmp_path)
    assert not list(tmp_path.iterdir())

"""The portal vein: vessels, radii and branching ratios by generation, grown against optimised."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from reports.common.figures import LOOKS, panels, save
from reports.common.pages import Compared, Facts, Page, table, write_csv
from reports.common.trees import Made, made, measured
from reports.common.tubes import Layer, View, write_views
from vascval.io.documents import ReferenceTable, read_reference_table
from vascval.report.plots import plain_log, whole_ticks

TITLE = "The portal vein"
FULL = {"n_terminals": 24_000, "topology": {}}
SMALL = {"n_terminals": 80, "topology": {"topology__at": 40, "topology__tests": 500}}
CAST_TABLE = "VASCVAL_CAST_TABLE"
"""Environment variable with the file of a published table by generation, for whoever has one."""
MEASURES = {
    "n_segments": "Number of vessels",
    "radius_mean_mm": "Mean radius (mm)",
    "branching_ratio_mean": "Mean branching ratio",
}


def trees(n_terminals: int, topology: Mapping[str, object]) -> tuple[Made, Made]:
    """The tree grown by CCO alone and the one of the whole framework."""
    return (
        made("portal-vein", n_terminals=n_terminals, method="cco"),
        made("portal-vein", n_terminals=n_terminals, method="full", **topology),
    )


def study(folder: Path, n_terminals: int, topology: Mapping[str, object]) -> Page:
    facts = Facts("portal_vein")
    cco, best = trees(n_terminals, topology)
    rows = {"growth alone": measured(cco.tree).generations, "optimised": measured(best.tree).generations}
    cast = cast_table()
    if cast is not None:
        rows["cast"] = cast.generations
    frame = side_by_side(rows)
    write_csv(frame, folder / "table.csv")
    draw(folder, rows, cast)
    views = [View("Growth alone", [Layer(cco.tree)]), View("Geometry and topology optimised", [Layer(best.tree)])]
    write_views(folder, views, columns=2, width_in=5.0, name="vessels")
    thinnest = rows["optimised"].iloc[-1]
    last, n_generations = float(thinnest["radius_mean_mm"]), len(rows["optimised"])
    common = frame[frame["generation"].between(1, 6)]
    wider, ratio = (
        100 * float((common[f"{name}_optimised"] / common[f"{name}_growth_alone"] - 1).mean())
        for name in ("radius_mean_mm", "branching_ratio_mean")
    )
    horton = measured(best.tree).horton.query("ordering == 'strahler' and quantity == 'number'")
    factor = float(horton["ratio"].iloc[-1])
    less = 100 * (1 - best.volume_mm3 / cco.volume_mm3)
    said = "up to {:.0f}".format(facts["generations of the optimised tree (up to)"])
    headline = (
        f"At {n_terminals:,} terminals the optimised tree has {n_generations} generations (paper {said}) and "
        f"{less:.1f} % less volume than growth alone; in generations 1 to 6 radii change by "
        f"{wider:+.1f} %, branching ratios by {ratio:+.1f} %."
    )
    text = f"""
`portal-vein`: the paper's parameters (table 3) with the {n_terminals:,} terminals of its text, in the bundled
liver-like shape of 1,500 cm³, since the perfusion volume of the paper's liver is not published. All measures by the
definitions of `vascval analyze`, the same for both trees.

{table(frame)}

{cast_words(cast)}

The paper's figures are not available as numbers; in words, the number of vessels differs little between grown and
optimised tree, mean radii of generations 1 to 6 are larger when optimised, and branching ratios of generations 4 to
6 lower. The mean radius of its cast at generation 13 is {facts["mean radius of the cast at generation 13"]:g} mm;
our trees end at generation {n_generations} with a mean of {last:.3f} mm, having {n_terminals:,} terminals where the
cast has all of its vessels down to the lobules. The number of Strahler generations of a tree is fixed by its number
of terminals and by how symmetric it is: one generation more needs {factor:.1f} times
the terminals, by the number ratio of its elements. Radii by
generation move with the way the vessels are numbered too: where optimising shifts a vessel to another generation,
the mean of both changes though no vessel became wider.
"""
    return Page(headline, compared(facts, n_generations, last, less, wider, ratio), text)


def compared(
    facts: Facts, n_generations: int, last_mm: float, less: float, wider: float, ratio: float
) -> list[Compared]:
    """Beside the paper: generations, mean radius of the last one, and percent by which optimising changes the rest."""
    return [
        facts.compared("generations of the optimised tree (up to)", n_generations),
        facts.compared(
            "mean radius of the cast at generation 13",
            last_mm,
            f"mean radius at the last generation (cast: 13, here: {n_generations})",
        ),
        Compared("volume against growth alone", None, f"{-less:+.1f} %"),
        Compared(
            "mean radius, generations 1 to 6, against growth", "larger (in words)", f"{wider:+.1f} %", "", "section 3.2"
        ),
        Compared(
            "branching ratio, generations 1 to 6, against growth",
            "lower, 4 to 6 most (in words)",
            f"{ratio:+.1f} %",
            "",
            "section 3.2",
        ),
    ]


def cast_table() -> ReferenceTable | None:
    name = os.environ.get(CAST_TABLE)
    return read_reference_table(Path(name)) if name else None


def cast_words(cast: ReferenceTable | None) -> str:
    if cast is None:
        return (
            "The tables of the paper's cast are not published with it. Whoever has them, or those of another cast, "
            f"names the file in `{CAST_TABLE}` (columns as of `vascval schema table-reference`) and finds it in table "
            "and figure."
        )
    return f"Cast: {cast.source}. {cast.citation}"


def side_by_side(rows: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """One row per generation, one column per measure and tree."""
    parts = []
    for measure in MEASURES:
        for name, frame in rows.items():
            if measure in frame:
                parts.append(frame.set_index("generation")[measure].rename(f"{measure}_{name.replace(' ', '_')}"))
    return pd.concat(parts, axis=1).sort_index().rename_axis("generation").reset_index()


def draw(folder: Path, rows: Mapping[str, pd.DataFrame], cast: ReferenceTable | None) -> None:
    figure, axes = panels(3, width_in=3.6)
    looks: dict[str, Any] = {"growth alone": LOOKS["cco"], "optimised": LOOKS["optimised"], "cast": LOOKS["cast"]}
    for place, (measure, title) in zip(axes, MEASURES.items()):
        for name, frame in rows.items():
            if measure in frame:
                shown = frame[np.isfinite(frame[measure].astype(float))]
                place.plot(shown["generation"], shown[measure], label=name, **looks[name])
        place.set(title=title, xlabel="generation")
        whole_ticks(place.xaxis)
        if measure == "branching_ratio_mean":
            place.set_ylim(0, 1)
        else:
            place.set_yscale("log")
            plain_log(place.yaxis)
    axes[0].legend()
    save(figure, folder)

"""The twin of a real portal vein: trees grown in its liver, held against it in numbers and in place."""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from reports.common.figures import GREEN, INK, RED
from reports.common.pages import Compared, Facts, Page, Skipped, percent, table, write_csv
from reports.common.trees import made
from reports.common.tubes import Layer, View, write_views
from vascval.cli.main import main
from vascval.io.trees import read_tree, write_tree

TITLE = "The twin of a real portal vein"
VARIANTS: dict[str, tuple[str, ...]] = {
    "as many terminals as the cast": (),
    "300 terminals": ("--set", "n_terminals=300"),
    "first two generations given": ("--root-generations", "2"),
}
FULL = {"real": True, "variants": VARIANTS}
SMALL = {"real": False, "variants": {"as many terminals as the cast": ("--set", "topology.tests=500")}}
PORTAL_VEIN, LIVER = "3Dircadb1.1_portalvein_mask.nrrd", "3Dircadb1.1_liver_mask.nrrd"
DATA = "VASCVAL_DATA"


def study(folder: Path, real: bool, variants: Mapping[str, Sequence[str]]) -> Page:
    facts = Facts("twin")
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        cast = real_cast() if real else grown_cast(work)
        outcomes = {label: twin(cast, work / str(k), options) for k, (label, options) in enumerate(variants.items())}
        trees = {name: read_tree(work / "0" / f"{name}.vtp") for name in ("cast", "cco", "optimised")}
    rows = pd.DataFrame([row for label, outcome in outcomes.items() for row in rows_of(label, outcome)])
    write_csv(rows, folder / "table.csv")
    write_csv(generations(next(iter(outcomes.values()))), folder / "generations.csv")
    black, red, green = (
        Layer(tree, colour, words)
        for tree, colour, words in zip(
            trees.values(), (INK, RED, GREEN), ("cast", "growth alone", "geometry and topology")
        )
    )
    views = [
        *(View(layer.label.capitalize(), [Layer(layer.tree)]) for layer in (black, red, green)),
        View("Growth alone over the cast", [black, red]),
        View("Optimised over the cast", [black, green]),
    ]
    write_views(folder, views, columns=3)
    first = next(iter(outcomes.values()))
    cco, best = (found for found in rows.to_dict("records")[:2])
    headline = (
        f"Within its tolerance {percent(best['matched_share'])} of the real vein's length lie on the optimised twin "
        f"({percent(cco['matched_share'])} on the grown one, {percent(best['by_chance_share'])} by chance): likeness "
        f"in kind, not in place; the paper sees agreement down to the fifth generation."
    )
    return Page(headline, compared(facts, rows, first), text(rows, first, real))


def real_cast() -> tuple[str, ...]:
    """The arguments that name the cast and its liver.

    :raises Skipped: where they are not there.
    """
    folder = Path(os.environ.get(DATA, Path(__file__).resolve().parents[3] / "shared" / "data")) / "ircad01"
    missing = [name for name in (PORTAL_VEIN, LIVER) if not (folder / name).exists()]
    if missing:
        raise Skipped(f"{missing[0]} of 3D-IRCADb-01 is not there; set {DATA} to the folder that has it in ircad01")
    return str(folder / PORTAL_VEIN), "--domain", str(folder / LIVER)


def grown_cast(work: Path) -> tuple[str, ...]:
    """A grown tree in place of a cast, to see that everything runs."""
    write_tree(made("portal-vein", n_terminals=30).tree, work / "cast.vtp")
    return (str(work / "cast.vtp"),)


def twin(cast: Sequence[str], folder: Path, options: Sequence[str]) -> dict[str, Any]:
    """The document of ``vascval twin``."""
    document = folder.with_suffix(".json")
    with contextlib.redirect_stdout(io.StringIO()):
        code = main(["twin", *cast, *options, "-o", str(folder), "--json", str(document), "--quiet"])
    if code != 0:
        raise RuntimeError(f"vascval twin ended with {code}")
    found: dict[str, Any] = json.loads(document.read_text(encoding="utf-8"))
    return found


def rows_of(label: str, outcome: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One row per grown tree: how it measures up to the cast."""
    rows = []
    cast = outcome["cast"]["summary"]
    for tree, place, land, made_of in zip(
        outcome["trees"], outcome["location"], outcome["territories"], outcome["twin"]["trees"]
    ):
        lengths = pd.DataFrame(place["generations"]).astype(float)
        weight = lengths["cast_length_mm"] / lengths["cast_length_mm"].sum()
        total = tree["summary"]
        rows.append(
            {
                "twin": label,
                "tree": made_of["method"],
                "terminals": total["n_terminals"],
                "matched_share": float((lengths["cast_matched_share"] * weight).sum()),
                "by_chance_share": float((lengths["cast_chance_share"] * weight).sum()),
                "distance_mean_mm": float((lengths["cast_distance_any_mean_mm"] * weight).sum()),
                "territories_dice": float(np.mean([row["dice"] for row in land["generations"][1:]]))
                if land
                else np.nan,
                "stem_radius_to_cast": made_of["root_radius_to_cast"],
                "volume_to_cast": total["volume_mm3"] / cast["volume_mm3"],
                "trifurcations": total["n_trifurcations"],
                "monopodial": total["n_monopodial"],
            }
        )
    return rows


def generations(outcome: Mapping[str, Any]) -> pd.DataFrame:
    """Radii, lengths and branching ratios by generation of cast and trees."""
    parts = []
    for name, side in zip(("cast", "cco", "full"), (outcome["cast"], *outcome["trees"])):
        frame = pd.DataFrame(side["generations"])
        parts.append(frame[["generation", "n_segments", "radius_mean_mm", "length_mean_mm", "branching_ratio_mean"]])
        parts[-1].insert(0, "tree", name)
    return pd.concat(parts)


def compared(facts: Facts, rows: pd.DataFrame, first: Mapping[str, Any]) -> list[Compared]:
    cast = first["cast"]["summary"]
    cco, best = rows.to_dict("records")[:2]
    return [
        facts.compared("trifurcations of the cast", cast["n_trifurcations"]),
        facts.compared("monopodial branches standard CCO", cco["monopodial"]),
        facts.compared("monopodial branches optimised tree", best["monopodial"]),
        Compared(
            "cast matched in place",
            "down to the fifth generation",
            f"down to generation {depth(first)}",
            "",
            "abstract",
        ),
    ]


def depth(outcome: Mapping[str, Any]) -> int:
    """The last generation down to which the optimised tree matches the cast."""
    return int(outcome["location"][-1]["matched_down_to_generation"])


def text(rows: pd.DataFrame, first: Mapping[str, Any], real: bool) -> str:
    cast, tolerance = first["cast"]["summary"], first["location"][0]["tolerance_mm"]
    notes = "\n".join(f"* {note}" for note in first["twin"]["notes"])
    drop = first["twin"]["trees"][-1]["pressure_drop_at_cast_root_mmhg"]
    source = (
        "The cast is the portal vein of case 1 of 3D-IRCADb-01 (IRCAD, CC BY-NC-ND 4.0), from a CT in vivo, the "
        "perfusion volume its liver mask"
        if real
        else "The cast is a grown tree"
    )
    return f"""
{source}. `vascval twin` skeletonises the cast, takes perfusion volume and root from it, grows two trees there with the
paper's parameters of the portal vein, by CCO alone and with geometry and topology optimised, and compares all three
as `vascval compare` does. What it had to say about this cast:

{notes}

{table(rows)}

"Matched" is the share of the cast's length within {tolerance:.1f} mm (or the local radius) of vessels of like
generation; "by chance" what a cast laid at random would show; Dice compares the territories that the generations
after the first perfuse. The paper judges by eye, on one cast of a whole organ, that places agree down to the fifth
generation where the hepatic vein is not in the way. A CT in vivo shows {cast["n_terminals"]} terminals where a
corrosion cast shows thousands; they end where the image does, not where the vessels do, so that terminals grown
evenly into the liver lie elsewhere than the ends of the image, and trees of so few terminals have thick vessels in
other places. Giving the first generations, or growing more terminals, shows how much of it is that.

The grown stem is {rows["stem_radius_to_cast"].iloc[1]:.2f} of the real radius. The preset spends the whole drop from 12
to 8 mmHg on the vessels that are grown, whereas in a stem as wide as the real one, with all its vessels widened alike,
the trees would need {drop:.2f} mmHg. If the flow is right, most of the real drop lies in vessels too thin to be seen.
The paper's absolute radii depend on the same choice; ratios between generations do not.
"""

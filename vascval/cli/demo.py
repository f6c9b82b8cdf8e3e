"""``vascval demo``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from vascval.cli import sources
from vascval.cli.compare import announce, write_report
from vascval.cli.console import Observer, progress
from vascval.cli.options import Selection, json_option

if TYPE_CHECKING:
    from vascval.core.tree import Tree

DIRECTORY = "vascval-demo"
BOX_MM = (60.0, 45.0, 30.0)
ROOT_MM = (0.0, 22.5, 15.0)
N_TERMINALS = 100
VOXEL_MM = 0.2
CAST_SEED, TREE_SEED = 1, 2


@click.command(
    short_help="The whole job with no input needed",
    epilog=f"""\b
Examples:
  vascval demo
  vascval demo -o somewhere --json demo.json

\b
Leaves in {DIRECTORY}, or where -o says, the report (report.html opens in a browser)
and the two files that were compared, so that the same can be had by
  vascval compare {DIRECTORY}/cast.nrrd {DIRECTORY}/tree.vtp
""",
)
@click.option(
    "-o",
    "--output",
    "directory",
    type=click.Path(path_type=Path),
    default=DIRECTORY,
    show_default=True,
    metavar="DIR",
    help="Where everything goes.",
)
@json_option
def demo(directory: Path, json_file: str | None) -> None:
    """The whole job with no input: grow a tree, cast it, compare the cast with another tree.

    Two trees of 100 terminals are grown in one box, from one root, with different random numbers. The first is cast:
    drawn into voxels. Of it nothing but that volume enters the comparison with the second.
    """
    sources.check_directory(directory)
    sources.check_json(json_file)
    from vascval.comparison import compare
    from vascval.imaging.rasterize import rasterize
    from vascval.io.atomic import atomic_directory
    from vascval.io.provenance import provenance
    from vascval.io.trees import write_tree
    from vascval.io.volumes import write_volume

    config = {"box_mm": BOX_MM, "root_mm": ROOT_MM, "n_terminals": N_TERMINALS, "voxel_mm": VOXEL_MM}
    with progress() as observer, atomic_directory(directory) as work:
        cast, tree = work / "cast.nrrd", work / "tree.vtp"
        write_volume(rasterize(_grown(CAST_SEED, observer), voxel_mm=VOXEL_MM), cast)
        origin = provenance(command="demo", config=config, seed=TREE_SEED, inputs=[])
        write_tree(_grown(TREE_SEED, observer), tree, provenance=origin)
        against = sources.measure(cast, cast.name, Selection(), None, observer)
        other = sources.measure(tree, tree.name, Selection(), None, observer)
        comparison = compare(against.analysis, [other.analysis], observer=observer)
        origin = provenance(command="demo", config=config, seed=CAST_SEED, inputs=[cast, tree])
        write_report(comparison, work, origin, against)
    announce(comparison, directory, json_file, origin)


def _grown(seed: int, observer: Observer | None) -> Tree:
    """A tree grown in the box: liver-like pressures and flow, Murray exponent 3, vessels that keep apart."""
    import numpy as np

    from generator.domain import Box
    from generator.growth.growth import Growth, GrowthOptions
    from generator.haemodynamics import Perfusion
    from vascval.core.units import MM3_S_PER_ML_MIN, PA_PER_MMHG, PA_S_PER_CP

    perfusion = Perfusion(12 * PA_PER_MMHG, 8 * PA_PER_MMHG, 1000 * MM3_S_PER_ML_MIN, 3.6 * PA_S_PER_CP, 3.0)
    growth = Growth(
        Box(np.array(BOX_MM)),
        perfusion,
        np.array(ROOT_MM),
        N_TERMINALS,
        options=GrowthOptions(apart=1.0),
        rng=np.random.default_rng(seed),
    )
    for step in growth.steps():
        if observer is not None:
            observer(f"growing tree {seed}", step.n_terminals, step.n_target)
    return growth.tree()

"""``vascval demo``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from vascval.cli import sources
from vascval.cli.compare import announce, compared, write_report
from vascval.cli.console import progress
from vascval.cli.options import Selection, json_option

if TYPE_CHECKING:
    from vascval.core.tree import Tree

DIRECTORY = "vascval-demo"
VOXEL_MM = 0.25


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
"""
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
    """The whole job with no input: make a tree, cast it, compare the cast with another tree."""
    sources.check_directory(directory)
    sources.check_json(json_file)
    from vascval.imaging.rasterize import rasterize
    from vascval.io.atomic import atomic_directory
    from vascval.io.provenance import provenance
    from vascval.io.trees import write_vtp
    from vascval.io.volumes import write_volume

    with progress() as observer, atomic_directory(directory) as work:
        cast, tree = work / "cast.nrrd", work / "tree.vtp"
        write_volume(rasterize(_tree(jitter=0.0), voxel_mm=VOXEL_MM), cast)
        write_vtp(_tree(jitter=0.1), tree)
        against = sources.measure(cast, cast.name, Selection(), None, observer)
        comparison = compared(against, [(tree, tree.name)], observer)
        origin = provenance(command="demo", config={"voxel_mm": VOXEL_MM}, seed=None, inputs=[cast, tree])
        write_report(comparison, work, origin, against)
    announce(comparison, directory, json_file)


def _tree(*, jitter: float, levels: int = 6) -> Tree:
    """A tree of ``2 ** levels`` terminals that forks in planes at right angles; ``jitter`` moves its nodes about.

    Radii follow Murray's law with exponent 3, the thinner child having 0.8 of the radius of the thicker; a vessel is
    8 radii long and its children leave at 35 and 50 degrees. Each node is displaced by a normal deviate of ``jitter``
    vessel lengths.
    """
    import numpy as np

    from vascval.core.tree import Topology, Tree

    random = np.random.default_rng(1)
    parent, position, radius = [-1, 0], [np.zeros(3), np.array([0.0, 0.0, 24.0])], [3.0, 3.0]
    frames = [np.eye(3), np.eye(3)]  # columns: the two directions across the vessel, the direction along it
    for node in range(1, 2**levels):
        thick = radius[node] / (1 + 0.8**3) ** (1 / 3)
        across, normal, along = frames[node].T
        for share, angle in ((1.0, np.deg2rad(35)), (0.8, -np.deg2rad(50))):
            direction = np.cos(angle) * along + np.sin(angle) * across
            parent.append(node)
            radius.append(share * thick)
            frames.append(np.column_stack([normal, np.cross(direction, normal), direction]))
            step = 8 * radius[-1] * (direction + jitter * random.standard_normal(3))
            position.append(position[node] + step)
    return Tree(Topology(np.array(parent)), np.array(position), np.array(radius))

"""``vascval view``."""

from __future__ import annotations

from pathlib import Path

import click

from vascval.cli import sources
from vascval.cli.options import unit_option


@click.command(
    short_help="A tree in 3-D",
    epilog="""\b
Examples:
  vascval view tree.vtp
  vascval view tree.swc --screenshot tree.png        without a display too
""",
)
@click.argument("tree", type=click.Path(path_type=Path))
@click.option("--screenshot", type=click.Path(path_type=Path), metavar="PNG", help="Write a picture, open no window.")
@unit_option
def view(tree: Path, screenshot: Path | None, unit: str | None) -> None:
    """Look at TREE in 3-D, coloured by order."""
    sources.require(tree, "tree", f"make one with: vascval skeletonize {tree} -o {tree.stem}.vtp")
    if screenshot is not None:
        if screenshot.suffix.lower() != ".png":
            raise click.BadParameter(f"{screenshot} does not end in .png", param_hint="--screenshot")
        sources.check_file(screenshot, [tree])
    from vascval.report.view import view as show

    show(sources.read_tree(tree, unit), screenshot=screenshot)

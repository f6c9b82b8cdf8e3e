"""``vascval schema``."""

from __future__ import annotations

import json

import click

from vascval.cli.console import say


@click.command(
    short_help="JSON Schemas of files read and written",
    epilog="""\b
Examples:
  vascval schema                      the names
  vascval schema compare > compare.schema.json
"""
)
@click.argument("name", required=False)
def schema(name: str | None) -> None:
    """Print the JSON Schema of a file that vascval reads or writes; without NAME, list the names."""
    from vascval.io import schemas

    if name is None:
        say("\n".join(schemas.names()))
    else:
        say(json.dumps(schemas.schema(name), indent=2))

"""``vascval schema``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from vascval.cli.console import say
from vascval.core.errors import InputError

CONFIGURATION = "configuration"


@click.command(
    short_help="JSON Schemas of files read and written",
    epilog="""\b
Examples:
  vascval schema                      the names
  vascval schema compare > compare.schema.json
  vascval schema --write data_schemas
""",
)
@click.argument("name", required=False)
@click.option("--write", "directory", type=click.Path(path_type=Path), metavar="DIR", help="Write all of them to DIR.")
def schema(name: str | None, directory: Path | None) -> None:
    """Print the JSON Schema of a file that vascval reads or writes; without NAME, list the names."""
    if directory is not None:
        if not directory.is_dir():
            raise InputError(f"{directory}: no such directory; make it first")
        for each in names():
            (directory / f"{each}.json").write_text(text(each) + "\n", encoding="utf-8")
    elif name is None:
        say("\n".join(names()))
    else:
        say(text(name))


def names() -> list[str]:
    """The names of all schemas: those of the documents and tables, and that of the generator's configuration."""
    from vascval.io import schemas

    return sorted([*schemas.names(), CONFIGURATION])


def text(name: str) -> str:
    """The schema of that name, indented."""
    return json.dumps(_schema(name), indent=2, ensure_ascii=False)


def _schema(name: str) -> dict[str, Any]:
    from vascval.io import schemas

    if name == CONFIGURATION:
        from generator.config import Config

        return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Config.model_json_schema()}
    return schemas.schema(name)

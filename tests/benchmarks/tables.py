"""What the benchmarks of the generator share: tables as Markdown, and a command line that prints the ones asked for."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def main(tables: Mapping[str, Callable[[], str]], subject: str) -> None:
    """Print the tables named on the command line, all without names."""
    parser = argparse.ArgumentParser(description=f"Benchmarks of {subject}, as tables.")
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"which ({', '.join(tables)}); all by default")
    names = parser.parse_args().tables
    unknown = sorted(set(names) - set(tables))
    if unknown:
        parser.error(f"no table is named {unknown[0]}; the tables are {', '.join(tables)}")
    for name in names or tables:
        print(f"\n## {name}\n\n{tables[name]()}", flush=True)

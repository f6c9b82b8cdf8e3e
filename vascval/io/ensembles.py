"""The JSON documents of an ensemble: its manifest and its result."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from vascval.io.documents import Document
from vascval.io.rows import EnsembleSpreadRow, EnsembleTreeRow


def _f(meaning: str, **options: Any) -> Any:
    return Field(description=meaning, **options)


State = Literal["missing", "done", "failed"]


class ManifestTree(Document):
    """One tree of an ensemble."""

    name: str = _f("of its files under trees, without suffix")
    case: str = _f("the keys in which its configuration differs from the common one; empty without a grid")
    seed: int = _f("seed of its random numbers")
    config_sha256: str = _f("checksum of what decides the tree: program, configuration, contents of input files")
    state: State = _f("whether it is there")
    sha256: str | None = _f("checksum of the tree's file", default=None)
    measures_sha256: str | None = _f("checksum of the JSON file beside it", default=None)
    seconds: float | None = _f("wall time on its worker", default=None)
    worker: str | None = _f("host and process that made it", default=None)
    error: str | None = _f("why it failed", default=None)


class ManifestDocument(Document):
    """``manifest.json`` of an ensemble."""

    version: str = _f("of the program")
    config_sha256: str = _f("checksum of config")
    config: dict[str, Any] = _f("common to all trees: flat keys without seed, checksums of input files and sources")
    trees: list[ManifestTree]


class EnsembleDocument(Document):
    """Output of ``vascval ensemble --json``."""

    n_trees: int = _f("trees asked for")
    n_done: int = _f("trees that there are")
    n_made: int = _f("trees made by this call; the others were there")
    cases: list[str] = _f("cases of the grid in order; one empty name without a grid")
    seconds: float = _f("wall time of making the trees")
    n_workers: int = _f("threads that worked at the beginning")
    manifest: list[ManifestTree] = _f("the trees asked for, as in the manifest")
    trees: list[EnsembleTreeRow] = _f("totals of each tree")
    totals: list[EnsembleSpreadRow] = _f("spread of the totals over the trees of a case")
    generations: list[EnsembleSpreadRow] = _f("the same for each measure of each generation")

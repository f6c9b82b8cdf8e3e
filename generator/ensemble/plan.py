"""Which trees an ensemble has: every case of a grid of parameters with every seed."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import vascval
from generator.code_checksum import code_sha256
from generator.config import Config, load
from vascval.core.errors import InputError
from vascval.io.provenance import sha256

CODE = "code"
FILES = ("domain.file", "root_tree", "terminals_file")


@dataclass(frozen=True)
class Order:
    """One tree to be made.

    ``name`` is that of its files, ``case`` says in which keys its configuration differs from the common one (``""``
    without a grid), ``identity`` is what decides the tree (:func:`identity`).
    """

    name: str
    case: str
    config: Config
    identity: dict[str, Any]

    @property
    def digest(self) -> str:
        """SHA-256 of what decides the tree."""
        return digest(self.identity)


@dataclass(frozen=True)
class Plan:
    """All trees in order, cases first; ``base`` is what decides the ensemble: all but seeds and grid."""

    orders: tuple[Order, ...]
    base: dict[str, Any]
    config: Config
    vary: dict[str, list[str]]
    n_seeds: int

    def inputs(self) -> list[Path]:
        """The files that decide the trees, each once."""
        flat = (flattened(order.config.model_dump()) for order in self.orders)
        return sorted({values[key] for values in flat for key in FILES if values.get(key) is not None})


def plan(name: str, changes: Sequence[str], vary: Sequence[str], n_seeds: int) -> Plan:
    """The trees of ``n_seeds`` seeds, counted from the configuration's on, in each case of the grid.

    :param name, changes: as of :func:`generator.config.load`.
    :param vary: ``key=v1,v2,...`` each; values that hold commas themselves are set apart by semicolons.
    :raises InputError: when the configuration, in any of its cases, is wrong, or the grid makes no sense.
    """
    if n_seeds < 1:
        raise InputError(f"--seeds {n_seeds}: no tree would be made; ask for 1 or more")
    grid = _grid(vary)
    known: dict[Path, str] = {}
    base = load(name, changes)
    orders: list[Order] = []
    for values in product(*grid.values()):
        settings = [f"{key}={value}" for key, value in zip(grid, values)]
        config = load(name, [*changes, *settings])
        for seed in range(config.seed, config.seed + n_seeds):
            seeded = config.model_copy(update={"seed": seed})
            orders.append(Order(_file_name(settings, seed), " ".join(settings), seeded, identity(seeded, known)))
    return Plan(tuple(_apart(orders)), _without_seed(identity(base, known)), base, grid, n_seeds)


def identity(config: Config, known: dict[Path, str] | None = None) -> dict[str, Any]:
    """What decides a tree as flat JSON values: the version and its sources, every key, and checksums in place of
    files' names.

    :param known: checksums of files already read, added to.
    :raises InputError: when a file cannot be read.
    """
    known = {} if known is None else known
    program = {"version": vascval.__version__, CODE: f"sha256 {code_sha256()}"}
    flat = {**program, **flattened(config.model_dump(mode="json"))}
    for key in FILES:
        if flat.get(key) is not None:
            path = Path(flat[key])
            if path not in known:
                known[path] = sha256(path)
            flat[key] = f"sha256 {known[path]}"
    return flat


def flattened(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested tables as one, with keys ``table.key``."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= flattened(value, f"{before}{key}.") if isinstance(value, Mapping) else {f"{before}{key}": value}
    return flat


def digest(flat: Mapping[str, Any]) -> str:
    """SHA-256 of flat JSON values, whatever their order."""
    return hashlib.sha256(json.dumps(flat, sort_keys=True).encode()).hexdigest()


def _without_seed(flat: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in flat.items() if key != "seed"}


def _grid(vary: Sequence[str]) -> dict[str, list[str]]:
    grid: dict[str, list[str]] = {}
    for text in vary:
        key, equals, values = (part.strip() for part in text.partition("="))
        parts = [part.strip() for part in values.split(";" if ";" in values else ",")]
        if not equals or not key or not all(parts):
            raise InputError(f"--vary {text}: is not key=v1,v2,...; write for example --vary gamma=2.5,3")
        if key == "seed":
            raise InputError(f"--vary {text}: seeds are counted by --seeds; set the first by --set seed=N")
        if key in grid or len(set(parts)) < len(parts):
            what = f"{key} comes twice" if key in grid else "a value comes twice"
            raise InputError(f"--vary {text}: {what}; name each key and value once")
        grid[key] = parts
    return grid


def _file_name(settings: Sequence[str], seed: int) -> str:
    parts = [setting.replace("=", "-") for setting in [*settings, f"seed={seed}"]]
    return re.sub(r"[^\w.+-]", "-", "_".join(parts))


def _apart(orders: Sequence[Order]) -> list[Order]:
    """Names that are the same after what no file name may hold was replaced are told apart by their checksum."""
    names = [order.name for order in orders]
    digests = [order.digest for order in orders]
    if len(set(digests)) < len(digests):
        twice = next(order for order in orders if digests.count(order.digest) > 1)
        raise InputError(f"--vary: {twice.case} is the same as another case; name each value once")
    return [
        order
        if names.count(order.name) == 1 and len(order.name) <= 150
        else Order(f"{order.name[:150]}_{order.digest[:12]}", order.case, order.config, order.identity)
        for order in orders
    ]

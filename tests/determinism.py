"""The same trees, byte for byte: ``python -m tests.determinism [PYTHON ...] [--threads N ...] [--set KEY=VALUE ...]``.

Grows trees with each Python, by default this one, and on 1, 2 and 4 threads, and prints the checksums of their files.
vascval must be there for each: installed, or by ``PYTHONPATH``. Exit code 1 when a tree is not always the same.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

TREES: dict[str, tuple[str, ...]] = {
    "box": ("karch-box", "n_terminals=600", "method=full"),
    "liver": ("portal-vein", "n_terminals=600", "method=full"),
    "apart": ("karch-box", "n_terminals=400", "method=geometry", "growth.avoid_intersections=true"),
}
"""A preset and changes of it: growth, a whole search on each chain, geometry; convex and not; vessels kept apart."""
THREADS = (1, 2, 4)


@dataclass(frozen=True)
class Grown:
    """A tree by name, the Python and the number of threads that made it, the SHA-256 of its file."""

    tree: str
    python: str
    threads: int
    sha256: str


def grown(pythons: Sequence[str], threads: Sequence[int], trees: Mapping[str, tuple[str, ...]]) -> Iterator[Grown]:
    """Every tree by every Python on every number of threads, each in a process of its own."""
    for tree, (preset, *changes) in trees.items():
        settings = [part for change in changes for part in ("--set", change)]
        for python in pythons:
            for count in threads:
                with tempfile.TemporaryDirectory() as folder:
                    path = Path(folder) / "tree.vtp"
                    command = [python, "-m", "vascval.cli", "generate", preset, *settings, "-o", str(path), "--quiet"]
                    environment = {**os.environ, "VASCVAL_THREADS": str(count)}
                    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
                    yield Grown(tree, python, count, hashlib.sha256(path.read_bytes()).hexdigest())


def differing(made: Sequence[Grown]) -> list[str]:
    """The trees of which there is more than one."""
    names = dict.fromkeys(one.tree for one in made)
    return [name for name in names if len({one.sha256 for one in made if one.tree == name}) > 1]


def versions(python: str) -> str:
    """What may make a difference, of one Python."""
    script = "import platform, numpy, scipy, numba as n; print(platform.python_version(), end=' with ');"
    script += "print('numpy', numpy.__version__, 'scipy', scipy.__version__, 'numba', n.__version__)"
    return subprocess.run([python, "-c", script], check=True, capture_output=True, text=True).stdout.strip()


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.determinism", description=__doc__.splitlines()[0])
    parser.add_argument("pythons", nargs="*", metavar="PYTHON", default=[sys.executable], help="default: this one")
    parser.add_argument("--threads", type=int, nargs="+", metavar="N", default=THREADS, help="default: 1 2 4")
    parser.add_argument("--set", dest="changes", action="append", default=[], metavar="KEY=VALUE", help="of all trees")
    given = parser.parse_args()
    for python in given.pythons:
        print(f"{python}: {versions(python)}", flush=True)
    made: list[Grown] = []
    trees = {name: (*changes, *given.changes) for name, changes in TREES.items()}
    for one in grown(given.pythons, given.threads, trees):
        made.append(one)
        print(f"{one.tree:6} {one.sha256[:16]} {one.threads} threads, {one.python}", flush=True)
    wrong = differing(made)
    print(f"not always the same: {', '.join(wrong)}" if wrong else "always the same")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

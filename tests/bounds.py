"""Kernels that read or write beyond an array: ``python -m tests.bounds``; some minutes.

Compiles all kernels with numba's checks of bounds, in a cache of their own, and runs them: whole commands in the box
and in the liver, on one root tree, as an ensemble, from voxels to a comparison, and the tests that try kernels against
oracles. Exit code 1 when a run fails, as it does at the first index that is too large, or when a kernel was never run.
A negative index counts from the end and is not noticed.
"""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VASCVAL = ("-m", "vascval.cli")
COMMANDS: dict[str, str] = {
    "box": "generate karch-box --set n_terminals=600 --set method=full -o box.vtp",
    "liver": "generate portal-vein --set n_terminals=600 --set method=full -o liver.vtp",
    "apart": "generate karch-box --set n_terminals=200 --set method=geometry --set growth.avoid_intersections=true "
    "--set viscosity=fahraeus-lindqvist -o apart.vtp",
    "optimum": "optimum karch-box --set n_terminals=6 -o optimum.vtp",
    "ensemble": "ensemble portal-vein --seeds 2 --set n_terminals=100 --set method=full --set topology.tests=20000 "
    "-o ensemble",
    "phantom": "demo -o demo",
    "root tree": "twin demo/cast.nrrd --root-generations 2 -o twin",
}
"""By name; they run one after the other in one folder."""
TESTS = (
    "tests/oracle",
    *(f"tests/unit/test_{name}.py" for name in (
        "small_trees", "small_volumes", "topology_annealing", "geometry_cases", "geometry_walls", "renewal",
        "checkpoint", "core", "io_arrays", "io_foreign_trees", "io_vtp_variants",
    )),
)  # fmt: skip


def checked(arguments: Sequence[str], folder: Path, cache: Path) -> int:
    """The exit code of this Python with these arguments in that folder, kernels being checked and kept in a cache.

    What it says of a failure is printed.
    """
    environment = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        print(done.stdout)
    return done.returncode


def kernels() -> set[str]:
    """All kernels of the project as ``folder/module.kernel``, but those that are inlined into others."""
    found = set[str]()
    for path in (*ROOT.glob("vascval/*/_*_kernels.py"), *ROOT.glob("generator/**/_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            marks = [ast.unparse(mark) for mark in getattr(node, "decorator_list", [])]
            if any(mark.startswith(("njit", "borrowing")) and "inline" not in mark for mark in marks):
                found.add(f"{path.parent.name}/{path.stem}.{node.name}")  # type: ignore[attr-defined]
    return found


def compiled(cache: Path) -> set[str]:
    """Those that numba has put into a cache: in ``FOLDER_digest``, as ``MODULE.KERNEL-LINE.pyVERSION.nbi``."""
    paths = cache.rglob("*.nbi")
    return {f"{path.parent.name.rpartition('_')[0]}/{path.name.partition('-')[0]}" for path in paths}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bounds", description=__doc__.splitlines()[0])
    parser.parse_args()
    failed = list[str]()
    with tempfile.TemporaryDirectory() as name:
        folder, cache = Path(name), Path(name, "cache")
        runs = {title: (*VASCVAL, *command.split(), "--quiet") for title, command in COMMANDS.items()}
        runs["tests"] = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(ROOT), "-c",
                         str(ROOT / "pyproject.toml"), *(str(ROOT / test) for test in TESTS))  # fmt: skip
        for title, arguments in runs.items():
            code = checked(arguments, folder, cache)
            print(f"{title}: {'done' if code == 0 else f'failed with code {code}'}", flush=True)
            failed += [title] if code else []
        present, run = kernels(), compiled(cache)
    print(f"{len(present & run)} of {len(present)} kernels were run", *sorted(present - run), sep="\n  ")
    return 1 if failed or present - run else 0


if __name__ == "__main__":
    sys.exit(main())

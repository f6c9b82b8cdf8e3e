"""``python -m tests.branches [TEST ...]``: branch coverage of every room with the compiler off, kernels being Python.

Prints for each room the share of branches taken and of lines and branches together, and below it the files of less than
``--least`` percent. Exit code 1 where the whole falls short of that.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ["tests/unit", "tests/oracle", "tests/property", "tests/physics", "tests/regression", "tests/cli"]

Files = dict[str, dict[str, float]]
COUNTS = ("num_statements", "covered_lines", "num_branches", "covered_branches")


def room(path: str) -> str:
    """The package that a file belongs to: ``generator.growth``, ``vascval.io``."""
    return ".".join(Path(path).parts[:-1])


def shares(files: Files) -> tuple[float, float]:
    """Percent of branches, and of lines and branches, that were taken."""
    total = {key: sum(file[key] for file in files.values()) for key in COUNTS}
    both = total["num_statements"] + total["num_branches"]
    taken = total["covered_lines"] + total["covered_branches"]
    return 100 * total["covered_branches"] / max(total["num_branches"], 1), 100 * taken / max(both, 1)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.branches", description=__doc__.splitlines()[0])
    parser.add_argument("tests", nargs="*", default=TESTS, metavar="TEST", help=f"default: {' '.join(TESTS)}")
    parser.add_argument("--seconds", type=float, default=20.0, help="CPU time after which a test is skipped (20)")
    parser.add_argument("--least", type=float, default=90.0, help="percent of the branches (90)")
    parser.add_argument("--json", type=Path, help="keep coverage.py's report here")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **os.environ, "NUMBA_DISABLE_JIT": "1", "COVERAGE_FILE": f"{folder}/data",
            "BRANCHES_SECONDS": str(given.seconds),
        }  # fmt: skip
        python = [sys.executable, "-m"]
        run = [
            *python,
            "coverage",
            "run",
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            "-p",
            "tests.branches.time_limit",
        ]
        subprocess.run([*run, *given.tests], cwd=ROOT, env=environment, check=False)
        report = given.json or Path(folder, "report.json")
        subprocess.run([*python, "coverage", "json", "-q", "-o", str(report)], cwd=ROOT, env=environment, check=True)
        files: Files = {name: file["summary"] for name, file in json.loads(report.read_text())["files"].items()}
    rooms: dict[str, Files] = defaultdict(dict)
    for name, file in files.items():
        rooms[room(name)][name] = file
    for title, part in sorted(rooms.items()):
        print("{:24} {:5.1f} % of branches, {:5.1f} % of lines and branches".format(title, *shares(part)))
        for name, file in sorted(part.items()):
            if file["num_branches"] and shares({name: file})[0] < given.least:
                print(f"    {name:42} {shares({name: file})[0]:5.1f} %")
    whole = shares(files)
    print("{:24} {:5.1f} % of branches, {:5.1f} % of lines and branches".format("all", *whole))
    return 0 if whole[0] >= given.least else 1


if __name__ == "__main__":
    sys.exit(main())

"""``python -m tests.branches [TEST ...]``: branch coverage of every room with the compiler off, kernels being Python.

Prints for each room the share of branches taken and of lines and branches together, and below it the files of less than
``--least`` percent. ``--room ROOM`` measures that room alone, by its own tests in ``ROOMS`` unless others are given;
a room that has no kernels is measured with the compiler on. Exit code 1 where the whole falls short of ``--least``, or
a test fails.
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
SMALL = "tests/unit/test_small_trees.py"
OWN_PROCESS = "not lost and not killed and not two_workers and not ctrl_c_keeps_what_is_done"
ROOMS = {
    "vascval.core": [
        "tests/unit/test_core.py", "tests/unit/test_core_refusals.py", "tests/property/test_ordering_property.py",
    ],
    "vascval.io": [
        *(f"tests/unit/test_io_{name}.py" for name in (
            "arrays", "files", "foreign_trees", "fuzz_findings", "header_refusals", "locks", "packed_files", "scans",
            "tree_refusals", "volume_refusals", "volumes", "vtp_variants",
        )),
        "tests/unit/test_schemas.py", "tests/property/test_io_round_trips.py",
    ],
    "vascval.morphometry": [
        *(f"tests/unit/test_morphometry_{name}.py" for name in (
            "coverage", "invariance", "measures", "orders", "organs",
        )),
        "tests/property/test_measures_property.py", "tests/oracle/test_morphometry_oracles.py",
    ],
    "vascval.comparison": [
        "tests/unit/test_comparison_compare.py", "tests/unit/test_perfusion_entry.py",
        "tests/oracle/test_comparison_oracles.py",
    ],
    "generator": [
        SMALL,
        *(f"tests/unit/test_{name}.py" for name in (
            "checkpoint", "generator_command", "generator_config", "generator_domains",
        )),
        "tests/property/test_haemodynamics_property.py",
        "-k", "not gone_on and not interrupt and not ctrl_c and not seconds_add and not same_command and "
        "not volume_contains and not segments_are and not distance_to_the_wall and not shapes_have",
    ],
    "generator.growth": [
        SMALL, *(f"tests/unit/test_{name}.py" for name in ("growth_cases", "generator_growth", "checkpoint")),
        "tests/oracle/test_generator_oracles.py",
        "-k", "small_trees or growth_cases or unsound or one_junction or sense or bad_input or reached or fermat or "
        "distance_between",
    ],
    "generator.geometry": [
        SMALL, *(f"tests/unit/test_geometry_{name}.py" for name in ("cases", "refusals")),
        "tests/oracle/test_geometry_parts.py",
        "-k", "not optimised_trees and not 700-",
    ],
    "generator.topology": [
        SMALL, "tests/unit/test_topology_annealing.py", "tests/oracle/test_topology_oracles.py",
        "-k", "small_trees or no_sense or single_branch or of_two or share_a_stem or best_of_all",
    ],
    "generator.ensemble": [
        "tests/unit/test_ensemble_plan.py", "tests/unit/test_ensemble_work.py", "tests/cli/test_cli_ensemble.py",
        "-k", OWN_PROCESS,
    ],
    "vascval.imaging": [
        *(f"tests/unit/test_{name}.py" for name in ("small_volumes", "perfusion_volume", "rasterize", "skeletonize")),
        "tests/oracle/test_imaging_oracles.py",
        "-k", "not phantom and not straight_vessel and not falls_with and not fall_with and not other_thinning and "
        "not in_proportion and not every_voxel and not islands_are and not world_frame and not root_is and "
        "not cleaned_vessels and not same_volume and not terminals_of_a_ball and not empty_middle and not dense_tree",
    ],
    "vascval.report": [
        *(f"tests/unit/test_report_{name}.py" for name in ("page", "parts")), "tests/cli/test_cli_history.py",
        "tests/cli/test_cli_commands.py", "tests/cli/test_cli_ensemble.py", "tests/cli/test_cli_twin.py",
        "-k", OWN_PROCESS,
    ],
    "vascval.cli": [
        "tests/cli", "tests/unit/test_generator_command.py", "tests/unit/test_checkpoint.py",
        "-k", f"{OWN_PROCESS} and not test_faults and not gone_on and not unsound",
    ],
}  # fmt: skip
"""What pytest is told to measure a room: tests that take moments, also without the compiler, and in this process."""

Files = dict[str, dict[str, float]]
COUNTS = ("num_statements", "covered_lines", "num_branches", "covered_branches")


def room(path: str) -> str:
    """The package that a file belongs to: ``generator.growth``, ``vascval.io``."""
    return ".".join(Path(path).parts[:-1])


def has_kernels(name: str | None) -> bool:
    """Whether there are kernels in the room; in some, if none is named."""
    return name is None or any(ROOT.joinpath(*name.split(".")).glob("_[a-z]*.py"))


def shares(files: Files) -> tuple[float, float]:
    """Percent of branches, and of lines and branches, that were taken."""
    total = {key: sum(file[key] for file in files.values()) for key in COUNTS}
    both = total["num_statements"] + total["num_branches"]
    taken = total["covered_lines"] + total["covered_branches"]
    return 100 * total["covered_branches"] / max(total["num_branches"], 1), 100 * taken / max(both, 1)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.branches", description=__doc__.splitlines()[0])
    parser.add_argument("tests", nargs="*", metavar="TEST", help=f"default: {' '.join(TESTS)}")
    parser.add_argument("--room", choices=ROOMS, metavar="ROOM", help=f"one of {', '.join(ROOMS)}")
    parser.add_argument("--seconds", type=float, default=60.0, help="CPU time after which a test is skipped (60)")
    parser.add_argument("--least", type=float, default=90.0, help="percent of the branches (90)")
    parser.add_argument("--json", type=Path, help="keep coverage.py's report here")
    given = parser.parse_args()
    tests = given.tests or (ROOMS[given.room] if given.room else TESTS)
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **os.environ, "NUMBA_DISABLE_JIT": str(int(has_kernels(given.room))),
            "COVERAGE_FILE": f"{folder}/data", "BRANCHES_SECONDS": str(given.seconds),
        }  # fmt: skip
        python = [sys.executable, "-m"]
        run = [*python, "coverage", "run", "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        limited = [*run, "-p", "tests.branches.time_limit", *tests]
        failed = subprocess.run(limited, cwd=ROOT, env=environment, check=False).returncode
        report = given.json or Path(folder, "report.json")
        subprocess.run([*python, "coverage", "combine", "-q"], cwd=ROOT, env=environment, check=True)
        subprocess.run([*python, "coverage", "json", "-q", "-o", str(report)], cwd=ROOT, env=environment, check=True)
        files: Files = {name: file["summary"] for name, file in json.loads(report.read_text())["files"].items()}
    rooms: dict[str, Files] = defaultdict(dict)
    for name, file in files.items():
        if given.room in (None, room(name)):
            rooms[room(name)][name] = file
    for title, part in sorted(rooms.items()):
        print("{:24} {:5.1f} % of branches, {:5.1f} % of lines and branches".format(title, *shares(part)))
        for name, file in sorted(part.items()):
            if file["num_branches"] and shares({name: file})[0] < given.least:
                print(f"    {name:42} {shares({name: file})[0]:5.1f} %")
    whole = shares({name: file for part in rooms.values() for name, file in part.items()})
    print("{:24} {:5.1f} % of branches, {:5.1f} % of lines and branches".format("all", *whole))
    if failed:
        print("tests failed: see above; what they take is counted up to where they do")
    return 0 if whole[0] >= given.least and not failed else 1


if __name__ == "__main__":
    sys.exit(main())

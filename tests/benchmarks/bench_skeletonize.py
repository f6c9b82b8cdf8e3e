"""Skeletonisation measured on phantoms: ``python -m tests.benchmarks.bench_skeletonize --help``.

Every run has a process of its own, which first skeletonises a small tree so that no compiler is on the clock, and is
then timed from the file on disk to the finished tree. Its memory is the peak of the whole process.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.tree import Topology, Tree
from vascval.imaging.rasterize import rasterize
from vascval.io.volumes import Volume, read_volume, write_volume

from .phantoms import KINDS, grow, phantom
from .score import score

NEEDS = {"vascval": "vascval.imaging", "skan": "skan", "kimimaro": "kimimaro"}
ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, eq=False)
class Run:
    """What one tool made of one image; ``image`` is its own record of what it did."""

    tree: Tree
    image: dict[str, Any]
    wall_s: float
    cpu_s: float
    peak_memory_mib: float


def run(tool: str, path: Path, root_mm: Sequence[float] | None) -> Run:
    """Skeletonise the image at ``path`` in a process of its own.

    :raises RuntimeError: with the end of what it said, when the process fails.
    """
    result = path.with_suffix(f".{tool}.npz")
    root = [] if root_mm is None else ["--root", ",".join(repr(float(x)) for x in root_mm)]
    command = [sys.executable, "-m", "tests.benchmarks.bench_skeletonize", "--worker", tool, str(path), str(result)]
    done = subprocess.run(command + root, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{tool} failed on {path.name}: {done.stderr.strip()[-2000:]}")
    with np.load(result) as arrays:
        tree = Tree(
            Topology(arrays["parent"]),
            arrays["position"],
            arrays["radius"],
            polyline_mm=arrays["polyline"],
            polyline_offset=arrays["offset"],
        )
    result.unlink()
    record = json.loads(done.stdout.splitlines()[-1])
    return Run(tree, record["image"], record["wall_s"], record["cpu_s"], record["peak_memory_mib"])


def work(tool: str, path: Path, result: Path, root_mm: np.ndarray | None) -> None:
    """The other process: warm up, skeletonise, save the tree and print the record."""
    warm = phantom("smooth", 0, size=64, n_terminals=3)
    skeletonise(tool, warm.volume, warm.truth.position_mm[0])
    wall, cpu = time.perf_counter(), time.process_time()
    tree, image = skeletonise(tool, read_volume(path), root_mm)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = peak_memory_mib()
    lines = [tree.polyline(i) for i in range(1, tree.n_nodes)]
    np.savez(
        result,
        parent=tree.parent,
        position=tree.position_mm,
        radius=tree.radius_mm,
        polyline=np.concatenate(lines),
        offset=np.concatenate(([0, 0], np.cumsum([len(line) for line in lines]))),
    )
    record = {"wall_s": wall, "cpu_s": cpu, "peak_memory_mib": peak, "image": image}
    print(json.dumps(record, default=lambda value: np.asarray(value).tolist()))


def peak_memory_mib() -> float:
    """Peak resident memory of this process.

    Linux counts the peak of the process that started this one into ``ru_maxrss``, so that its own record is preferred.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return int(re.search(r"VmHWM:\s+(\d+) kB", status.read_text())[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def skeletonise(tool: str, volume: Volume, root_mm: np.ndarray | None) -> tuple[Tree, dict[str, Any]]:
    """Tree and record by the named tool; ours finds the root by itself when none is given."""
    if tool != "vascval":
        from .rivals import kimimaro_tree, skan_tree

        trace = skan_tree if tool == "skan" else kimimaro_tree
        return trace(volume, volume.origin_mm if root_mm is None else root_mm)
    from vascval.imaging import skeletonize

    found = skeletonize(volume, root_mm=root_mm)
    return found.tree, dict(found.image)


def compare_tools(tools: Sequence[str], options: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """A row for each kind, seed and tool."""
    rows = []
    for kind in options.kinds:
        for seed in range(options.seeds):
            made = phantom(kind, seed, size=options.size, n_terminals=options.terminals, bend_mm=options.bend)
            path = folder / f"{made.name}.nrrd"
            write_volume(made.volume, path)
            for tool in tools:
                root = made.truth.position_mm[0] if tool != "vascval" or options.give_root else None
                result = run(tool, path, root)
                points = score(result.tree, made.truth, 1.0, image=result.image)
                drawn = score(result.tree, made.drawn, 1.0).radius_error
                row = {"kind": kind, "seed": seed, "tool": tool, **points.as_dict(), "radius_error_drawn": drawn}
                row |= {"wall_s": result.wall_s, "cpu_s": result.cpu_s, "peak_memory_mib": result.peak_memory_mib}
                rows.append(row)
                print(_line(row, result.image), flush=True)
            path.unlink()
    return rows


HEADER = (
    "| kind | seed | tool | tips found | false | loops | radius error (bias; as drawn) | length bias (total) | "
    "off axis | junctions found / false | trifurcations found / false | elements per order (deviation) | "
    "wall | CPU | memory |\n" + "|---" * 15 + "|"
)


def _line(row: dict[str, Any], image: dict[str, Any]) -> str:
    three = "{trifurcations_found:.0%} of {n_trifurcations}".format(**row) if row["n_trifurcations"] else "none"
    elements = "equal" if row["elements_equal"] else "{elements_found} for {elements_true}".format(**row)
    stages = f" (thinning + graph {image['thinning_s'] + image['graph_s']:.2f} s)" if "thinning_s" in image else ""
    cells = (
        "{kind} | {seed} | {tool} | {tips_found:.1%} | {tips_false:.1%} | {n_loops}",
        "{radius_error:.2%} ({radius_bias:+.2%}; {radius_error_drawn:.2%})",
        "{length_bias:+.2%} ({total_length_bias:+.2%}) | {centreline_offset:.2f}",
        "{junctions_found:.1%} / {n_junctions_false} | {three} / {n_trifurcations_false}",
        "{elements} ({elements_deviation:.1%})",
        "{wall_s:.2f} s{stages} | {cpu_s:.2f} s | {peak_memory_mib:.0f} MiB",
    )
    return ("| " + " | ".join(cells) + " |").format(**row, three=three, elements=elements, stages=stages)


ERRORS = ("radius_error", "length_error", "tip_offset_mm", "junction_offset_mm", "centreline_offset_mm")


def convergence(tool: str, options: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """One tree in finer and finer voxels: errors, and the slope of log error over log voxel by least squares.

    The tree has terminals of 2 mm in a box of half the size; the voxels go from 1 mm down to a half.
    """
    n_terminals = max(3, options.terminals // 8)
    truth = grow(np.random.default_rng(0), n_terminals=n_terminals, size=options.size // 2, bend_mm=options.bend)
    rows = []
    print("| voxel mm | " + " | ".join(ERRORS) + " | tips found |\n" + "|---" * (2 + len(ERRORS)) + "|")
    for voxel_mm in 2.0 ** -np.array([0.0, 1 / 3, 2 / 3, 1.0]):
        path = folder / "convergence.nrrd"
        write_volume(rasterize(truth, voxel_mm=voxel_mm, margin_mm=3.0), path)
        result = run(tool, path, truth.position_mm[0])
        points = score(result.tree, truth, voxel_mm, image=result.image, tolerance_voxels=5.0 / voxel_mm).as_dict()
        points |= {
            f"{part}_offset_mm": points[f"{part}_offset"] * voxel_mm for part in ("tip", "junction", "centreline")
        }
        rows.append({"voxel_mm": float(voxel_mm), "tool": tool, **points})
        cells = (f"{voxel_mm:.3f}", *(f"{points[name]:.4f}" for name in ERRORS), f"{points['tips_found']:.1%}")
        print("| " + " | ".join(cells) + " |", flush=True)
    log_voxel = np.log([row["voxel_mm"] for row in rows])
    orders = [np.polyfit(log_voxel, np.log([row[name] for row in rows]), 1)[0] for name in ERRORS]
    print("| order | " + " | ".join(f"{order:.2f}" for order in orders) + " | |")
    return rows


def available(tools: Sequence[str]) -> list[str]:
    """Those of the tools that can run; the reason is printed for the others."""
    usable = []
    for tool in tools:
        if importlib.util.find_spec(NEEDS[tool]) is None:
            print(f"{tool} left out: {NEEDS[tool]} is not installed")
        else:
            usable.append(tool)
    return usable


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench_skeletonize", description=__doc__)
    parser.add_argument("--kinds", default=",".join(KINDS), help="which phantoms, separated by commas")
    parser.add_argument("--seeds", type=int, default=3, help="how many of each kind")
    parser.add_argument("--size", type=int, default=400, help="edge of the box in voxels of 1 mm")
    parser.add_argument("--terminals", type=int, help="terminals of the tree (default: 300 in a box of 400)")
    parser.add_argument("--bend", type=float, default=0.0, help="amplitude of curved centrelines, mm")
    parser.add_argument("--tools", default=",".join(NEEDS), help="which tools, separated by commas")
    parser.add_argument("--give-root", action="store_true", help="tell ours the root, as the rivals are told")
    parser.add_argument("--convergence", action="store_true", help="errors against voxel size instead of the table")
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    parser.add_argument("--worker", nargs=3, metavar=("TOOL", "IMAGE", "RESULT"), help=argparse.SUPPRESS)
    parser.add_argument("--root", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    options.kinds, options.tools = options.kinds.split(","), options.tools.split(",")
    unknown = [name for name in options.kinds if name not in KINDS] + [t for t in options.tools if t not in NEEDS]
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}; kinds: {', '.join(KINDS)}; tools: {', '.join(NEEDS)}")
    if options.terminals is None:
        options.terminals = max(3, round(300 * (options.size / 400) ** 3))
    return options


def main(arguments: Sequence[str] | None = None) -> list[dict[str, Any]]:
    options = parse(arguments)
    if options.worker:
        tool, path, result = options.worker
        root = None if options.root is None else np.array([float(x) for x in options.root.split(",")])
        work(tool, Path(path), Path(result), root)
        return []
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        tools = available(options.tools)
        if options.convergence:
            for tool in tools:
                print(f"\n{tool}\n")
                rows += convergence(tool, options, Path(folder))
        elif tools:
            print(HEADER)
            rows = compare_tools(tools, options, Path(folder))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return rows


if __name__ == "__main__":
    main()

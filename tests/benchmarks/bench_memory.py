"""Skeletonisation of large volumes, block by block: ``python -m tests.benchmarks.bench_memory --help``.

Volumes are drawn slab by slab into raw files (or zarr), never whole in memory. Every run has a process of its own,
warmed up on a small tree; its memory is the peak of the whole process, its time is taken from the file to the tree.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from vascval.core.contraction import contract_degenerate
from vascval.core.ordering import root_first, strahler_order
from vascval.core.tree import Topology, Tree
from vascval.imaging.rasterize import rasterize

from .bench_skeletonize import ROOT, peak_memory_mib
from .phantoms import grow, phantom
from .score import TOLERANCE_VOXELS, elements_per_order, match_tips, restricted, score
from .tables import table

SLAB = 25
Size = tuple[int, int, int]


def draw(tree: Tree, shape: Size, path: Path) -> None:
    """The tree in voxels of 1 mm, as MetaImage with a raw file or as zarr by the suffix of ``path``."""
    write = _zarr_writer(path, shape) if path.suffix == ".zarr" else _raw_writer(path, shape)
    nz, ny, nx = shape
    for z in range(0, nz, SLAB):
        block = ((z, min(z + SLAB, nz)), (0, ny), (0, nx))
        write(z, rasterize(tree, voxel_mm=1.0, shape=shape, origin_mm=(0.0, 0.0, 0.0), block=block).values)


def _raw_writer(path: Path, shape: Size) -> Callable[[int, np.ndarray], None]:
    raw = path.with_suffix(".raw")
    raw.write_bytes(b"")
    size = " ".join(map(str, shape[::-1]))
    lines = (
        "ObjectType = Image",
        "NDims = 3",
        f"DimSize = {size}",
        "ElementType = MET_UCHAR",
        "ElementSpacing = 1 1 1",
    )
    path.write_text("\n".join((*lines, f"ElementDataFile = {raw.name}")) + "\n")

    def write(_z: int, values: np.ndarray) -> None:
        with raw.open("ab") as stream:
            values.tofile(stream)

    return write


def _zarr_writer(path: Path, shape: Size) -> Callable[[int, np.ndarray], None]:
    import zarr

    chunks = (SLAB, min(256, shape[1]), min(256, shape[2]))
    group = zarr.open_group(str(path), mode="w")
    array = group.create_array("0", shape=shape, chunks=chunks, dtype="u1")
    axes = [{"name": axis, "type": "space", "unit": "millimeter"} for axis in "zyx"]
    steps = [{"type": "scale", "scale": [1.0, 1.0, 1.0]}]
    image = {"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": steps}]}
    group.attrs["ome"] = {"version": "0.5", "multiscales": [image]}

    def write(z: int, values: np.ndarray) -> None:
        array[z : z + len(values)] = values

    return write


def forest_tree(n_terminals: int, shape: Size, *, seed: int = 0, tip_mm: float = 1.6) -> Tree:
    """A tree with so many terminals that fills a box of ``shape`` voxels of 1 mm.

    The box is halved along its longest edge again and again, in proportion to the terminals of the halves, and a node
    near the middle of each part feeds the nodes of its two halves. Radii obey Murray's law with exponent 3. Terminals
    are far apart, but a few end in a thick vessel that passes there (:func:`blurred`).
    """
    rng = np.random.default_rng(seed)
    size = np.array(shape[::-1], dtype=np.float64)
    parent, position, feeds = [-1], [np.array([size[0] / 2, size[1] / 2, 60.0])], [n_terminals]
    stack = [(0, np.zeros(3), size, n_terminals)]
    while stack:
        above, low, high, n = stack.pop()
        jitter = rng.uniform(-0.1, 0.1, 3) * (high - low)
        position.append((low + high) / 2 + jitter)
        parent.append(above)
        feeds.append(n)
        node = len(parent) - 1
        if n == 1:
            continue
        axis, left = int(np.argmax(high - low)), n // 2
        cut = low[axis] + (high[axis] - low[axis]) * left / n
        first_high, second_low = high.copy(), low.copy()
        first_high[axis] = second_low[axis] = cut
        stack += [(node, second_low, high, n - left), (node, low, first_high, left)]
    parents = np.array(parent)
    order = root_first(parents)
    new = np.empty_like(order)
    new[order] = np.arange(order.size)
    radius = tip_mm * np.cbrt(np.array(feeds, dtype=np.float64))
    return Tree(
        Topology(np.concatenate(([-1], new[parents[order[1:]]])).astype(np.int32)),
        np.array(position)[order],
        radius[order],
    )


def blurred(tree: Tree) -> np.ndarray:
    """(N,) terminals that belong to a vessel, from the stem to themselves, which runs into another one.

    A terminal does so where it comes within a voxel of any vessel but its parent and siblings, another segment where it
    comes as near to one that is thicker and no neighbour of it either. In an image it is a part of that vessel, or
    a loop, and nothing tells what it belongs to.
    """
    parent, position, radius = tree.parent, tree.position_mm, tree.radius_mm
    begin = position[np.maximum(parent, 0)]
    way = position - begin
    middle, reach = begin + way / 2, np.linalg.norm(way, axis=1) / 2 + radius
    is_terminal = tree.topology.n_children == 0
    result = np.zeros(tree.n_nodes, dtype=bool)
    for node in range(1, tree.n_nodes):
        if result[parent[node]]:
            result[node] = True
            continue
        near = ((middle - middle[node]) ** 2).sum(axis=1) < (reach + reach[node] + 1.0) ** 2
        near &= (parent != parent[node]) & (parent != node) & (is_terminal[node] | (radius > radius[node]))
        near[[0, node, parent[node]]] = False
        line = begin[node] + np.linspace(0.0, 1.0, 60)[:, None] * way[node]
        # within the ball of its junction it meets what its parent and siblings meet
        line = line[np.linalg.norm(line - begin[node], axis=1) > radius[parent[node]] + 3.0 * radius[node]]
        square = np.maximum((way[near] ** 2).sum(axis=1), 1e-300)
        share = np.clip(np.einsum("ijk,jk->ij", line[:, None] - begin[near], way[near]) / square, 0.0, 1.0)
        apart = np.linalg.norm(line[:, None] - begin[near] - share[:, :, None] * way[near], axis=2) - radius[near]
        result[node] = apart.min(initial=np.inf) < radius[node] + 1.0
    return result & is_terminal


def clear_tips(found: Tree, truth: Tree) -> tuple[int, int, bool]:
    """How many terminals were missed, how many of these are not blurred, and whether the elements of each Strahler
    order are equal where both trees are cut down to the terminals found that are not blurred.

    (In a tree that halves again and again one terminal less lowers the order of every vessel from there to the root.)
    """
    truth = contract_degenerate(truth)
    of_truth, of_found, _ = match_tips(found, truth, TOLERANCE_VOXELS)
    clear = ~blurred(truth)
    kept = (of_truth >= 0) & clear
    elements = [
        elements_per_order(restricted(truth, kept)),
        elements_per_order(restricted(found, np.isin(of_found, of_truth[kept]))),
    ]
    missed = truth.topology.terminals[of_truth[truth.topology.terminals] < 0]
    return missed.size, int(clear[missed].sum()), np.array_equal(*elements)


@dataclass(frozen=True, eq=False)
class Run:
    """A run of its own process: the tree, and the record with ``cpu_s``, ``wall_s``, ``peak_mib`` and ``image``."""

    tree: Tree
    record: dict[str, Any]


def run(path: Path, *, whole: bool = False, max_memory_bytes: int | None = None) -> Run:
    """Skeletonise the file block by block, or read ``whole``.

    :raises RuntimeError: with the end of what it said, when the process fails.
    """
    result = path.with_suffix(".npz")
    command = [sys.executable, "-m", "tests.benchmarks.bench_memory", "--worker", str(path), str(result)]
    command += ["--whole"] if whole else []
    command += [] if max_memory_bytes is None else ["--max-memory", str(max_memory_bytes)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{path.name}: {done.stderr.strip()[-2000:]}")
    with np.load(result) as arrays:
        tree = Tree(
            Topology(arrays["parent"]),
            arrays["position"],
            arrays["radius"],
            polyline_mm=arrays["polyline"],
            polyline_offset=arrays["offset"],
        )
    result.unlink()
    return Run(tree, json.loads(done.stdout.splitlines()[-1]))


def work(path: Path, result: Path, whole: bool, max_memory_bytes: int | None) -> None:
    """The other process."""
    from vascval.imaging import skeletonize
    from vascval.io.scans import open_scan
    from vascval.io.volumes import read_volume

    skeletonize(phantom("smooth", 0, size=64, n_terminals=3).volume)
    wall, cpu = time.perf_counter(), time.process_time()
    stages: list[tuple[str, float]] = []
    found = skeletonize(
        read_volume(path) if whole else open_scan(path),
        max_memory_bytes=max_memory_bytes,
        observer=lambda stage, _done, _total: stages.append((stage, time.process_time())),
    )
    record = {
        "wall_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "peak_mib": peak_memory_mib(),
        "stages_s": {name: b - a for (name, a), (_, b) in pairwise(stages)},
        "image": found.image,
    }
    tree = found.tree
    np.savez(
        result,
        parent=tree.parent,
        position=tree.position_mm,
        radius=tree.radius_mm,
        polyline=tree.polyline_mm,
        offset=tree.polyline_offset,
    )
    print(json.dumps(record, default=lambda value: np.asarray(value).tolist()))


def equal(one: Tree, other: Tree) -> bool:
    """Whether two trees have the same segments, centrelines, radii and orders, bit for bit."""
    names = ("parent", "position_mm", "radius_mm", "polyline_mm", "polyline_offset")
    same = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
    return same and np.array_equal(strahler_order(one.topology), strahler_order(other.topology))


def blocks(size: int, n_terminals: int, limit: int, folder: Path) -> str:
    """The same volume in one piece, and block by block from raw files and zarr within a limit."""
    tree = grow(np.random.default_rng(0), n_terminals=n_terminals, size=size)
    rows, first = [], None
    for name, whole in (("cast.mhd", True), ("cast.mhd", False), ("cast.zarr", False)):
        path = folder / name
        if not path.exists():
            draw(tree, (size, size, size), path)
        made = run(path, whole=whole, max_memory_bytes=None if whole else limit)
        first = first or made
        record = made.record
        how = "in one piece" if whole else f"{path.suffix[1:]}, block by block"
        same = "" if made is first else "equal" if equal(made.tree, first.tree) else "DIFFERENT"
        share = f"{record['cpu_s'] / first.record['cpu_s']:.2f}"
        cells = (
            f"{made.tree.topology.n_terminals:,}",
            f"{record['cpu_s']:.1f} s",
            share,
            f"{record['peak_mib']:.0f} MiB",
        )
        rows.append((how, f"{record['image']['n_voxels']:,}", *cells, same))
    return table(("volume", "vessel voxels", "terminals", "CPU", "CPU / in one piece", "peak memory", "tree"), rows)


def scaling(sizes: Sequence[tuple[Size, int]], limit: int, folder: Path, suffix: str) -> str:
    """Larger and larger casts drawn slab by slab: time, memory and agreement with the truth."""
    header = (
        *("voxels", "Mvoxels", "vessel voxels", "terminals found / false", "missed / of these clear of others"),
        *("elements per order over clear terminals", "radius error", "CPU", "us / vessel voxel", "wall"),
        *("peak memory", "bytes / vessel voxel"),
    )
    rows = []
    for shape, n_terminals in sizes:
        truth = forest_tree(n_terminals, shape)
        path = folder / f"cast{suffix}"
        draw(truth, shape, path)
        made = run(path, max_memory_bytes=limit)
        _remove(path)
        record, points = made.record, score(made.tree, truth, 1.0, image=made.record["image"])
        n = record["image"]["n_voxels"]
        missed, missed_clear, elements_equal = clear_tips(made.tree, truth)
        rows.append(
            (
                " x ".join(map(str, shape[::-1])),
                f"{np.prod(shape) / 1e6:,.0f}",
                f"{n:,}",
                f"{points.tips_found:.2%} of {n_terminals:,} / {points.tips_false:.2%}",
                f"{missed} / {missed_clear}",
                "equal" if elements_equal else "DIFFERENT",
                f"{points.radius_error:.2%}",
                f"{record['cpu_s']:.1f} s",
                f"{1e6 * record['cpu_s'] / n:.2f}",
                f"{record['wall_s']:.1f} s",
                f"{record['peak_mib']:.0f} MiB",
                f"{record['peak_mib'] * 2**20 / n:.0f}",
            )
        )
        print(json.dumps(record["stages_s"]), file=sys.stderr, flush=True)
    return table(header, rows)


def _remove(path: Path) -> None:
    import shutil

    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
        path.with_suffix(".raw").unlink()


SIZES: tuple[tuple[Size, int], ...] = (
    ((375, 500, 500), 312),
    ((750, 1000, 1000), 2500),
    ((1125, 1500, 1500), 8437),
    ((1500, 2000, 2000), 20000),
)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench_memory", description=__doc__)
    parser.add_argument("tables", nargs="*", default=["blocks", "scaling"], help="blocks, scaling; both by default")
    parser.add_argument("--size", type=int, default=800, help="blocks: edge of the box in voxels")
    parser.add_argument("--terminals", type=int, default=1500, help="blocks: terminals of the tree")
    parser.add_argument("--steps", type=int, default=len(SIZES), help="scaling: how many of the sizes")
    parser.add_argument("--suffix", choices=(".mhd", ".zarr"), default=".mhd", help="scaling: format of the volumes")
    parser.add_argument("--folder", type=Path, help="where the volumes are drawn (6 GB); a temporary folder by default")
    parser.add_argument("--worker", nargs=2, metavar=("IMAGE", "RESULT"), help=argparse.SUPPRESS)
    parser.add_argument("--whole", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--max-memory", type=int, help="bytes; 2 GB for blocks and 8 GB for scaling by default")
    options = parser.parse_args(arguments)
    if unknown := set(options.tables) - {"blocks", "scaling"}:
        parser.error(f"no table is named {sorted(unknown)[0]}; the tables are blocks, scaling")
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    options = parse(arguments)
    if options.worker:
        work(Path(options.worker[0]), Path(options.worker[1]), options.whole, options.max_memory)
        return
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        if "blocks" in options.tables:
            limit = options.max_memory or 2_000_000_000
            print("\n" + blocks(options.size, options.terminals, limit, Path(folder)), flush=True)
        if "scaling" in options.tables:
            limit = options.max_memory or 8_000_000_000
            print("\n" + scaling(SIZES[: options.steps], limit, Path(folder), options.suffix), flush=True)


if __name__ == "__main__":
    main()

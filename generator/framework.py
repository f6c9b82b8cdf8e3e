"""From a configuration to a tree: the stages in order, each an iterator of steps."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from generator.config import Config
from generator.domain import Domain
from generator.domains import make_domain
from generator.geometry.stage import GeometryStage
from generator.growth.growth import Growth, Step
from generator.growth.insertion_order import spread_order
from generator.growth.root_tree import RootTree
from generator.topology.stage import TopologyStage
from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.io.trees import read_tree


@dataclass
class Stage:
    """A stage that was run: its name, seconds of wall time, volume of the tree after it; optimisations solved and
    topologies tried, where that is what it does."""

    name: str
    seconds: float
    volume_mm3: float
    solves: int | None = None
    tests: int | None = None


@dataclass
class Run:
    """One tree being made. Iterate over :meth:`steps`; what there is can be had at any time from :meth:`tree`."""

    config: Config
    domain: Domain
    growth: Growth
    stages: list[Stage] = field(default_factory=list)
    _optimised: Tree | None = None

    @classmethod
    def of(cls, config: Config) -> Run:
        """:raises InputError: when a file or a value of the configuration is wrong."""
        domain = make_domain(config.domain)
        rng = np.random.default_rng(config.seed)
        root, terminals = _start(config, domain, rng)
        count = config.n_terminals if terminals is None else len(terminals)
        growth = Growth(
            domain, config.flow(), root, count, options=config.growth_options(), rng=rng, terminals_mm=terminals
        )
        return cls(config, domain, growth)

    def steps(self) -> Iterator[tuple[str, Step]]:
        """The name of the stage and where it stands, again and again until all is done (Algorithm 1 of the paper)."""
        full, optimised = self.config.method == "full", self.config.method != "cco"
        growth, topology, geometry = (Stage(name, 0.0, 0.0) for name in ("growth", "topology", "geometry"))
        self.stages += [growth, *([topology] if full else []), *([geometry] if optimised else [])]
        target = self.growth.n_terminals
        searched = not full
        while True:
            until = min(target, self._pause(searched))
            began = time.perf_counter()
            for step in self.growth.steps(until):
                yield growth.name, step
                now = time.perf_counter()
                growth.seconds, growth.volume_mm3, began = growth.seconds + now - began, step.volume_mm3, now
            done = until == target or self.growth.stopped_at_thinnest
            if done or not searched:
                growth.volume_mm3 = self.growth.tree().volume_mm3
            if not searched:
                yield from self._search(topology)
                searched = True
            elif not done:
                parent, position = self.growth.snapshot()
                self.growth.put(parent, self.geometry.relax(parent, position))
                geometry.seconds += time.perf_counter() - began
            if done:
                break
        if optimised:
            yield geometry.name, Step(0, 1, self.growth.volume_mm3)
            began = time.perf_counter()
            self._optimised = self.geometry.finish(*self.growth.snapshot()).tree
            geometry.seconds += time.perf_counter() - began
            geometry.volume_mm3, geometry.solves = self._optimised.volume_mm3, self.geometry.solves
            yield geometry.name, Step(1, 1, geometry.volume_mm3)

    def _pause(self, searched: bool) -> int:
        """The number of terminals at which growth pauses next."""
        if not searched:
            return self.config.topology.at
        if self.config.method == "cco" or not self.geometry.during_growth:
            return self.growth.n_terminals
        return self.growth.n_grown + self.config.geometry.interval(self.growth.n_grown)

    def _search(self, stage: Stage) -> Iterator[tuple[str, Step]]:
        """The topology of the tree as it is now; what was found stays when the search is left off."""
        began = time.perf_counter()
        try:
            for step in self.topology.search(*self.growth.snapshot()):
                stage.seconds, stage.volume_mm3 = time.perf_counter() - began, step.best_mm3
                yield stage.name, Step(step.n_tests, step.n_target, step.best_mm3)
        finally:
            self.growth.put(*self.topology.best())
            stage.seconds, stage.tests = time.perf_counter() - began, self.topology.tests
            stage.volume_mm3 = self.growth.tree().volume_mm3

    @cached_property
    def topology(self) -> TopologyStage:
        return TopologyStage(self.config, self.domain, self.growth.root_tree, self.growth.rng)

    @cached_property
    def geometry(self) -> GeometryStage:
        return GeometryStage(self.config, self.domain, self.growth.root_tree)

    def tree(self) -> Tree:
        """The tree as it is now, perfused."""
        return self._optimised or self.growth.tree()

    def inputs(self) -> list[Path]:
        """The files that decide the tree."""
        files = (self.config.domain.file, self.config.root_tree, self.config.terminals_file)
        return [path for path in files if path is not None]


def _start(
    config: Config, domain: Domain, rng: np.random.Generator
) -> tuple[np.ndarray | RootTree, np.ndarray | None]:
    """The root, or root tree, and the terminals if they are given."""
    root: np.ndarray | RootTree | None = getattr(domain, "root_mm", None)
    terminals = None
    if config.terminals_file is not None:
        rows = read_points(config.terminals_file)
        root, terminals = rows[0], rows[1:]
    if config.root_mm is not None:
        root = np.array(config.root_mm)
    if config.root_tree is not None:
        root = RootTree.of(read_tree(config.root_tree))
    if root is None:
        raise InputError("no root is given; add root_mm=X,Y,Z (mm), inside the domain")
    if terminals is not None and config.terminals_order != "given":
        at = root.position_mm[0] if isinstance(root, RootTree) else root
        shuffled = config.terminals_order == "random"
        order = rng.permutation(len(terminals)) if shuffled else spread_order(terminals, at, rng)
        terminals = terminals[order]
    return root, terminals


def read_points(path: Path) -> np.ndarray:
    """(K, 3) the points of a CSV file with the columns ``x_mm,y_mm,z_mm``: the root and the terminals.

    :raises InputError: when the file is missing, has other columns, is not numeric or has fewer than two rows.
    """
    import pandas

    columns = ["x_mm", "y_mm", "z_mm"]
    try:
        frame = pandas.read_csv(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check terminals_file") from None
    except (OSError, ValueError) as error:  # pandas' parser errors are ValueErrors
        raise InputError(f"{path}: cannot be read as CSV ({str(error).splitlines()[0]}); mend it") from error
    missing = [name for name in columns if name not in frame.columns]
    if missing:
        raise InputError(f"{path}: has no column {', '.join(missing)}; the columns x_mm,y_mm,z_mm are needed")
    try:
        points = frame[columns].to_numpy(dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{path}: holds text where numbers are needed ({error}); mend it") from error
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"{path}: row {bad[0] + 1} is not finite; mend or drop it")
    if len(points) < 2:
        raise InputError(f"{path}: has {len(points)} rows; the root and at least one terminal are needed")
    return points

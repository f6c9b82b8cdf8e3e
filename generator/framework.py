"""From a configuration to a tree: the stages in order, each an iterator of steps."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from generator.checkpoint import State
from generator.config import Config
from generator.domain import Domain
from generator.domains import make_domain
from generator.geometry.stage import GeometryStage
from generator.growth.growth import Growth, Step
from generator.growth.insertion_order import spread_order
from generator.growth.root_tree import RootTree
from generator.kept import below, with_prefix
from generator.topology.stage import TopologyStage
from vascval.core.errors import InputError
from vascval.core.tree import Tree
from vascval.core.validation import Claims
from vascval.io.trees import read_tree

_STAGES = {"cco": ["growth"], "geometry": ["growth", "geometry"], "full": ["growth", "topology", "geometry"]}


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
    """One tree being made. Iterate over :meth:`steps`; what there is can be had at any time from :meth:`tree`.

    At each step, before the iterator is left off, and while ``settled`` is true, :meth:`state` is all that it takes to
    go on: another run of the same configuration that is given it by :meth:`restore` ends in the same tree, bit for bit.
    """

    config: Config
    domain: Domain
    growth: Growth
    stages: list[Stage] = field(default_factory=list)
    settled: bool = False
    _until: int | None = None  # terminals at which growth pauses next; None: to be decided
    _searched: bool = False
    _searching: dict[str, np.ndarray] | None = None  # a search to go on with
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
        stages = [Stage(name, 0.0, 0.0) for name in _STAGES[config.method]]
        return cls(config, domain, growth, stages, _searched=config.method != "full")

    def steps(self) -> Generator[tuple[str, Step], None, None]:
        """The name of the stage and where it stands, again and again until all is done (Algorithm 1 of the paper)."""
        target = self.growth.n_terminals
        done = False
        while not done:
            if self._until is None:
                self._until = min(target, self._pause())
            yield from self._grow(self._until)
            done = self._until == target or self.growth.stopped_at_thinnest
            if not self._searched:
                yield from self._search()
            elif not done:
                self._relax()
            self._until = target if done else None
        if self.config.method != "cco":
            yield from self._finish()

    def state(self) -> State:
        """Where the run stands, as copies."""
        record = {"stages": [asdict(stage) for stage in self.stages], "until": self._until, "searched": self._searched}
        arrays = with_prefix("growth", self.growth.state())
        searching = self.topology.state(done=self._searched) if self.topology.begun else self._searching
        arrays |= with_prefix("topology", searching or {})
        return State(record, arrays)

    def restore(self, state: State) -> None:
        """Take over what :meth:`state` gave; the seconds of the stages go on from there.

        :raises InputError: when it is not sound; do not go on from here then.
        """
        record = state.record
        try:
            stages = [Stage(**stage) for stage in record["stages"]]
            self._until, self._searched = record["until"], bool(record["searched"])
            sound = [stage.name for stage in stages] == [stage.name for stage in self.stages]
            sound = sound and (self._until is None or 1 <= int(self._until) <= self.growth.n_terminals)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError("does not say where the run stood; begin the run anew") from error
        if not sound:
            raise InputError("says of other stages than the run has; begin the run anew")
        self.growth.restore(below("growth", state.arrays))
        self._searching = below("topology", state.arrays) or None
        if self._searching is not None and self._searched:
            self.topology.recall(self._searching)
        self.stages = stages
        for stage in stages:
            if stage.name == "geometry":
                self.geometry.solves = stage.solves or 0

    def _stage(self, name: str) -> Stage:
        return next(stage for stage in self.stages if stage.name == name)

    def _pause(self) -> int:
        """The number of terminals at which growth pauses next."""
        if not self._searched:
            return self.config.topology.at
        if self.config.method == "cco" or not self.geometry.during_growth:
            return self.growth.n_terminals
        return self.growth.n_grown + self.config.geometry.interval(self.growth.n_grown)

    def _grow(self, until: int) -> Iterator[tuple[str, Step]]:
        stage, began = self._stage("growth"), time.perf_counter()
        for step in self.growth.steps(until):
            now = time.perf_counter()
            stage.seconds, stage.volume_mm3, began = stage.seconds + now - began, step.volume_mm3, now
            yield stage.name, step
        if until == self.growth.n_terminals or self.growth.stopped_at_thinnest or not self._searched:
            stage.volume_mm3 = self.growth.tree().volume_mm3

    def _relax(self) -> None:
        """The growing tree nearer to its best geometry."""
        stage, began = self._stage("geometry"), time.perf_counter()
        parent, position = self.growth.snapshot()
        self.settled = True
        position = self.geometry.relax(parent, position)
        self.settled = False
        self.growth.put(parent, position)
        stage.seconds, stage.solves = stage.seconds + time.perf_counter() - began, self.geometry.solves

    def _finish(self) -> Iterator[tuple[str, Step]]:
        stage = self._stage("geometry")
        yield stage.name, Step(0, 1, self.growth.volume_mm3)
        began = time.perf_counter()
        self.settled = True
        self._optimised = self.geometry.finish(*self.growth.snapshot()).tree
        self.settled = False
        stage.seconds += time.perf_counter() - began
        stage.volume_mm3, stage.solves = self._optimised.volume_mm3, self.geometry.solves
        yield stage.name, Step(1, 1, stage.volume_mm3)

    def _search(self) -> Iterator[tuple[str, Step]]:
        """The topology of the tree as it is now; what was found stays when the search is left off."""
        stage, began = self._stage("topology"), time.perf_counter()
        try:
            for _ in self.topology.search(*self.growth.snapshot(), resume=self._searching):
                now = time.perf_counter()
                stage.seconds, stage.volume_mm3, began = stage.seconds + now - began, self.topology.best_mm3, now
                yield stage.name, Step(self.topology.tests, self.topology.target, stage.volume_mm3)
        finally:
            self.growth.put(*self.topology.best())
            stage.seconds, stage.tests = stage.seconds + time.perf_counter() - began, self.topology.tests
            stage.volume_mm3 = self.growth.tree().volume_mm3
        self._searched = True

    @cached_property
    def topology(self) -> TopologyStage:
        return TopologyStage(self.config, self.domain, self.growth.root_tree, self.growth.rng)

    @cached_property
    def geometry(self) -> GeometryStage:
        return GeometryStage(self.config, self.domain, self.growth.root_tree)

    def tree(self) -> Tree:
        """The tree as it is now, perfused."""
        return self._optimised or self.growth.tree()

    def claims(self, tree: Tree) -> Claims:
        """What the tree of this run holds: Murray's law where radii were free and the exponent is one, and one
        pressure at all terminals."""
        given = {position.tobytes() for position in self.growth.root_tree.position_mm}
        from_root_tree = np.array([position.tobytes() in given for position in tree.position_mm])
        one_gamma = not (self.config.method != "cco" and self.config.geometry.gamma_by_generation)
        return Claims(self.config.gamma if one_gamma else None, equal_pressure=True, given=from_root_tree)

    def inputs(self) -> list[Path]:
        """The files that decide the tree."""
        files = (self.config.domain.file, self.config.root_tree, self.config.terminals_file)
        return [path for path in files if path is not None]


def _start(config: Config, domain: Domain, rng: np.random.Generator) -> tuple[np.ndarray | RootTree, np.ndarray | None]:
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
    except (ValueError, OverflowError) as error:  # OverflowError: whole numbers of hundreds of digits
        raise InputError(f"{path}: holds text where numbers are needed ({error}); mend it") from error
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"{path}: row {bad[0] + 1} is not finite; mend or drop it")
    if len(points) < 2:
        raise InputError(f"{path}: has {len(points)} rows; the root and at least one terminal are needed")
    return points

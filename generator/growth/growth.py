"""Constrained constructive optimisation (Karch 1999; paper, section 2.2): a tree grown terminal by terminal.

A point drawn from the domain, far enough from the tree, is tried as a new terminal on each of the nearest segments;
the bifurcation is put where the volume of the whole tree is least, and the best connection stays. ``Growth`` holds the
state; it is advanced by iterating over :meth:`Growth.steps` and may be left off and read at any step.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from generator.domain import Domain
from generator.growth import _growth_kernels as kernels
from generator.growth._records import Rules
from generator.growth.root_tree import RootTree
from generator.growth.state import GrowthState
from generator.haemodynamics import Perfusion
from generator.kept import below, fits, set_words, with_prefix, words_of
from vascval.core.errors import ComputationError, InputError
from vascval.core.tree import Tree

_STEP_S = 0.2
_BATCH = 100
_SLACK = 1.1
"""Vessels are kept apart by this much more than asked while they grow, as radii change with what comes later."""
_MENDINGS = 40


@dataclass(frozen=True)
class GrowthOptions:
    """How a tree is grown.

    * ``n_connections``: nearest segments tried for each new terminal;
    * ``spacing``: the k-th terminal is drawn farther from all segments than this times ``(volume / k)^(1/3)``; the
      distance falls by a tenth after every ten points refused. The paper leaves it open. 0.4 spreads terminals more
      evenly than 1 does and saves 7 % of volume, because early vessels follow the domain rather than its far corners;
    * ``diameters``: shortest length of a new segment in its own diameters;
    * ``shortest_mm``: shortest length of a new segment;
    * ``merge_mm``: a bifurcation this close to the proximal node of the segment is not made, the new terminal springs
      from that node instead (Algorithm 1, lines 4-8); ``None``: bifurcations only;
    * ``thinnest_mm``: smallest radius of a new terminal, ``at_thinnest`` what happens there: growth ends (``stop``) or
      fails (``error``);
    * ``apart``: vessels without a common node keep apart by this times the sum of their radii; 0: they may overlap.

    :raises InputError: when a value makes no sense.
    """

    n_connections: int = 32
    spacing: float = 0.4
    diameters: float = 1.0
    shortest_mm: float = 0.0
    merge_mm: float | None = None
    thinnest_mm: float = 0.0
    at_thinnest: Literal["stop", "error"] = "error"
    apart: float = 0.0

    def __post_init__(self) -> None:
        if self.n_connections < 1:
            raise InputError(f"n_connections is {self.n_connections}; at least one segment must be tried")
        for name in ("spacing", "diameters", "shortest_mm", "thinnest_mm", "apart"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"{name} is {value}; a finite number of 0 or more is needed")

    @property
    def rules(self) -> Rules:
        merge = -1.0 if self.merge_mm is None else self.merge_mm
        return Rules(self.n_connections, self.diameters, self.shortest_mm, merge, self.thinnest_mm, self.apart)


@dataclass(frozen=True)
class Step:
    """Where growth stands: terminals so far and asked for, volume of the tree."""

    n_terminals: int
    n_target: int
    volume_mm3: float


class Growth:
    """A tree that grows in a domain.

    :param root: the root point (3,), or the root tree whose segments and radii are given.
    :param n_terminals: how many terminals to grow.
    :param terminals_mm: (n_terminals, 3) where they are, in the order of insertion; drawn from ``rng`` if ``None``.
    :raises InputError: when the root or terminals lie outside, or terminals coincide.
    """

    def __init__(
        self,
        domain: Domain,
        perfusion: Perfusion,
        root: np.ndarray | RootTree,
        n_terminals: int,
        *,
        options: GrowthOptions | None = None,
        rng: np.random.Generator,
        terminals_mm: np.ndarray | None = None,
    ) -> None:
        self.domain, self.perfusion, self.rng = domain, perfusion, rng
        self.options = options or GrowthOptions()
        self._rules = self.options.rules
        self.root_tree = root if isinstance(root, RootTree) else RootTree.point(root)
        self.root_tree.require_inside(domain)
        if n_terminals < len(self.root_tree.open_nodes):
            raise InputError(
                f"n_terminals is {n_terminals}; at least {len(self.root_tree.open_nodes)} are needed, one for the root "
                "or for each end of the root tree"
            )
        self.n_terminals = int(n_terminals)
        self._given = None if terminals_mm is None else _checked_terminals(domain, terminals_mm, self.n_terminals)
        self._spacing_mm = self.options.spacing * float(np.cbrt(domain.volume_mm3))
        self._points = np.zeros((0, 3))
        self._outcome = np.zeros(0, np.int8)
        self._state = GrowthState(domain, perfusion, self.root_tree, self.n_terminals, apart=self.options.apart > 0.0)
        self._measured = self._mendings = 0
        self._scratch = np.zeros(self.options.n_connections, np.int32), np.zeros(self.options.n_connections)
        self.stopped_at_thinnest = False

    @property
    def n_grown(self) -> int:
        """Terminals so far."""
        return self._state.n_terminals

    @property
    def volume_mm3(self) -> float:
        """Volume of the vessels grown so far, without the root tree's."""
        return self._state.volume_mm3

    @property
    def begun(self) -> bool:
        """Whether there is a tree to speak of: a vessel at the root, or at every end of the root tree."""
        return self._state.begun

    def tree(self) -> Tree:
        """What has grown so far, perfused: see :func:`generator.haemodynamics.perfused_tree`.

        :raises ComputationError: when nothing has grown, or the root tree uses up the pressure.
        """
        if not self.begun:
            raise ComputationError("nothing has grown yet; let growth go on for a step")
        return self._state.tree()

    def snapshot(self) -> tuple[np.ndarray, np.ndarray]:
        """``parent`` (N,) and ``position_mm`` (N, 3), root first, the nodes of the root tree before all others."""
        return self._state.snapshot()

    def put(self, parent: np.ndarray, position_mm: np.ndarray) -> None:
        """Go on from another tree with the same root tree and terminals, numbered as :meth:`snapshot` does."""
        self._state.put(parent, position_mm)
        self._measured = 0

    def state(self) -> dict[str, np.ndarray]:
        """All that decides how growth goes on, as plain arrays that are copies; sound between two steps."""
        rules = self._rules
        kept = {
            "rng": words_of(self.rng),
            "points": self._points.copy(),
            "outcome": self._outcome.copy(),
            "progress": np.array([self._measured, self._mendings, self.stopped_at_thinnest], np.int64),
            "rules": np.array([rules.diameters, rules.shortest_mm, rules.merge_mm, rules.apart], np.float64),
        }
        if self._given is not None:
            kept["given"] = self._given.copy()
        return {**kept, **with_prefix("tree", self._state.state())}

    def restore(self, kept: dict[str, np.ndarray]) -> None:
        """Take over what :meth:`state` gave for growth with the same parameters; it goes on to the same tree.

        :raises InputError: when it is not sound or of other parameters; do not go on from here then.
        """
        kinds: dict[str, tuple[str, tuple[int | None, ...]]] = {
            "rng": ("uint64", (6,)), "points": ("float64", (None, 3)), "outcome": ("int8", (None,)),
            "progress": ("int64", (3,)), "rules": ("float64", (4,)),
        }  # fmt: skip
        if self._given is not None:
            kinds["given"] = ("float64", (None, 3))
        if not fits(kept, kinds) or len(kept["points"]) != len(kept["outcome"]):
            raise InputError("lacks a part of the growth; begin the run anew")
        points = np.vstack([kept["points"], kept.get("given", np.zeros((0, 3)))])
        low, high = self._state.grid.bounds_mm
        sound = ((points >= low) & (points <= high)).all() and self._state.restore(below("tree", kept))
        if not sound or self._state.store.counts[3] > len(kept["points"]):
            raise InputError("holds a growing tree that is not sound; begin the run anew")
        set_words(self.rng, kept["rng"])
        self._points, self._outcome = kept["points"].copy(), kept["outcome"].copy()
        self._given = kept["given"].copy() if self._given is not None else None
        self._measured, self._mendings = (int(value) for value in kept["progress"][:2])
        self.stopped_at_thinnest = bool(kept["progress"][2])
        diameters, shortest, merge, apart = (float(value) for value in kept["rules"])
        self._rules = self._rules._replace(diameters=diameters, shortest_mm=shortest, merge_mm=merge, apart=apart)

    def steps(self, until: int | None = None) -> Iterator[Step]:
        """Grow, a fraction of a second at a time, until all terminals are placed or the thinnest radius is reached.

        :param until: stop at so many terminals; growth may go on from there, and vessels may overlap yet.
        :raises InputError: when terminals cannot be placed.
        :raises ComputationError: when ``thinnest_mm`` cannot be kept and ``at_thinnest`` is ``error``, or vessels
            cannot be kept apart.
        """
        pace = 100
        goal = self.n_terminals if until is None else min(until, self.n_terminals)
        while True:
            began = time.perf_counter()
            if not self.begun:
                self._begin()
            self._advance(min(self.n_grown + pace, goal))
            here = self.n_grown >= goal or self.stopped_at_thinnest
            if here and (goal < self.n_terminals or not self._mend_overlaps()):
                break
            took = time.perf_counter() - began
            pace = int(max(50, pace * min(2.0, _STEP_S / max(took, 1e-3))))
            yield Step(self.n_grown, self.n_terminals, self.volume_mm3)
        yield Step(self.n_grown, self.n_terminals, self.volume_mm3)

    def _mend_overlaps(self) -> bool:
        """Take vessels out that have come to overlap as radii grew; their terminals are to be grown again."""
        if self.options.apart == 0.0:
            return False
        dropped = self._state.drop_overlapping(self.options.apart)
        self._mendings += len(dropped) > 0
        if self._mendings > _MENDINGS:
            raise ComputationError(
                f"{len(dropped)} terminals still overlap other vessels after {_MENDINGS} rounds of growing them anew; "
                "grow fewer terminals or let vessels overlap"
            )
        self._measured = 0
        if len(dropped) and self._given is not None:
            self._points, self._outcome = dropped, np.zeros(len(dropped), np.int8)
            self._state.store.counts[3] = 0
        return len(dropped) > 0

    def _begin(self) -> None:
        """A first terminal at the root, or at every end of the root tree: points nearest to it that it can see."""
        ends = self.root_tree.open_nodes
        position = self.root_tree.position_mm[ends]
        for number, node in enumerate(ends):
            point = self._first_point(number, position)
            self._state.begin(node, point)
        self._state.require_pressure()

    def _first_point(self, number: int, ends: np.ndarray) -> np.ndarray:
        for _ in range(50):
            points = self.domain.sample(200, self.rng) if self._given is None else self._given
            offset = ((points[:, None] - ends[None]) ** 2).sum(axis=2)
            mine = np.flatnonzero((offset.argmin(axis=1) == number) & (offset[:, number] > 0.0))
            seen = mine[self.domain.segments_inside(np.broadcast_to(ends[number], (mine.size, 3)), points[mine])]
            if seen.size:
                if self._given is not None:
                    self._given = np.delete(self._given, seen[0], axis=0)
                return points[seen[0]]
            if self._given is not None:
                break
        raise InputError(
            f"no terminal can be placed at the root {ends[number].round(3).tolist()}: no point nearest to it is joined "
            "to it by a straight line inside the domain; move the root away from the wall or into a wider place"
        )

    def _advance(self, target: int) -> None:
        """Grow to ``target`` terminals, refilling points and laying the grid anew as needed."""
        state = self._state
        spacing = self._spacing_mm if self._given is None else -1.0
        while self.n_grown < target and not self.stopped_at_thinnest:
            if self.n_grown >= state.grid.good_until:
                state.renew()
            goal = min(target, state.grid.good_until)
            if state.apart:
                if self.n_grown >= self._measured:
                    self._measure()
                goal = min(goal, self._measured)
            code = kernels.grow(
                state.store, state.stems, self._rules, state.grid.grid, self.domain.space, self._points,
                self._outcome, spacing, goal, *self._scratch,
            )  # fmt: skip
            if code == kernels.NO_ROOM:
                state.grid.widen()
            elif code == kernels.NO_MORE_POINTS:
                self._refill()
            elif code == kernels.STUCK:
                self._stuck()

    def _measure(self) -> None:
        """Radii anew, and the room that vessels must leave for what theirs will be.

        With ``k`` of ``N`` terminals the trunk is thinner by about ``(k / N)^(1/gamma - 1/3)`` than at the end (a
        fit to growth in the box for gamma 2.1, 2.55 and 3, which takes 0.02 more).
        """
        self._state.measure_radii()
        self._measured = self.n_grown + max(1, self.n_grown // 20)
        widening = (self.n_terminals / self.n_grown) ** (1.0 / self.perfusion.gamma - 1.0 / 3.0 + 0.02)
        rules = self.options.rules
        self._rules = self._rules._replace(
            apart=_SLACK * widening * rules.apart,
            diameters=widening * rules.diameters if self._rules.diameters > 0.0 else 0.0,
        )

    def _refill(self) -> None:
        if self._given is not None:
            self._refill_given()
            return
        self._points = self.domain.sample(_BATCH * min(max(self.n_grown, 20), 10_000), self.rng)
        self._outcome = np.zeros(len(self._points), np.int8)
        self._state.store.counts[3] = 0

    def _refill_given(self) -> None:
        """The points that were refused once more: the tree may have come nearer; last without rules for lengths."""
        assert self._given is not None
        refused = self._points[self._outcome != kernels.PLACED] if len(self._points) else self._given
        if len(refused) == len(self._points):
            relaxed = self._rules._replace(diameters=0.0, shortest_mm=0.0, merge_mm=-1.0)
            if self._rules == relaxed:
                first = refused[0].round(3).tolist()
                how = "that keep apart from all others" if self._state.apart else "inside the domain"
                raise InputError(
                    f"{len(refused)} terminals cannot be joined to the tree by straight vessels {how} (first: "
                    f"{first}); move or drop them" + (", or let vessels overlap" if self._state.apart else "")
                )
            self._rules = relaxed
        self._points, self._outcome = refused, np.zeros(len(refused), np.int8)
        self._state.store.counts[3] = 0

    def _stuck(self) -> None:
        if self._outcome[self._state.store.counts[3] - 1] == kernels.TOO_THIN:
            if self.options.at_thinnest == "stop":
                self.stopped_at_thinnest = True
                return
            raise ComputationError(
                f"terminal {self.n_grown + 1} would be thinner than r_min {self.options.thinnest_mm:g} mm: with this "
                "pressure drop and flow so many cannot be that thick; ask for fewer, lower r_min, or stop there"
            )
        raise InputError(
            f"{self._state.store.counts[4]} points in a row could not be joined to the tree of {self.n_grown} "
            "terminals: the rest of the domain cannot be reached in straight lines, or the rules for length and "
            "distance leave no room; ask for fewer terminals or relax the rules"
        )


def _checked_terminals(domain: Domain, terminals_mm: np.ndarray, n_terminals: int) -> np.ndarray:
    points = np.array(terminals_mm, dtype=np.float64)
    if points.shape != (n_terminals, 3):
        raise InputError(f"terminals have shape {points.shape}; ({n_terminals}, 3) is needed")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"{bad.size} terminals are not finite (first: number {bad[0] + 1}); mend or drop them")
    outside = np.flatnonzero(~domain.contains(points))
    if outside.size:
        first = points[outside[0]].round(3).tolist()
        raise InputError(
            f"{outside.size} terminals lie outside the domain (first: number {outside[0] + 1} at {first}); move or "
            "drop them"
        )
    return points

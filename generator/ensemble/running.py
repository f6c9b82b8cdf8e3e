"""Trees made by workers: handed out, watched and taken back as they are done."""

from __future__ import annotations

import queue
import secrets
import time
import traceback
from collections import Counter, deque
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from generator.ensemble.plan import Order
from generator.ensemble.work import STAGES, Failed, Grown, Measure, make, warm_up
from generator.ensemble.workers import by_host, n_threads
from vascval.core.errors import ComputationError

if TYPE_CHECKING:
    from distributed import Client, Future

_SECONDS_BETWEEN_LOOKS = 1.0
_TRIES_MORE = 3
_ALL_LOST = "every worker that made it was lost; the machine may be short of memory"
_SCHEDULER_LOST = "the scheduler was lost; call again once it is there to make the missing trees"


@dataclass(frozen=True)
class Begun:
    """A worker began a tree; ``again`` after another was lost with it."""

    name: str
    worker: str
    again: bool = False


@dataclass(frozen=True)
class Share:
    """How much of a tree is done, from 0 to 1."""

    name: str
    share: float


@dataclass(frozen=True)
class Finished:
    """A tree is there, or failed."""

    order: Order
    result: Grown | Failed


@dataclass(frozen=True)
class Lost:
    """A worker was lost with a tree."""

    order: Order


@dataclass(frozen=True)
class Deserted:
    """There are no workers left; it goes on when there are."""


Event = Begun | Share | Finished | Deserted


def warm(client: Client, order: Order, measure: Measure) -> list[str]:
    """Has every worker load the kernels, all at once, and one of each machine compile those that were never compiled
    there; reasons why it could not be done."""
    futures = [
        client.submit(
            warm_up, order, str(Path.cwd()), measure, compiles=worker == addresses[0], workers=[worker],
            allow_other_workers=True, pure=False,
        )
        for addresses in by_host(client)
        for worker in addresses
    ]  # fmt: skip
    return [reason for reason in dict.fromkeys(client.gather(futures)) if reason]


def run(client: Client, orders: Sequence[Order], measure: Measure) -> Generator[Event, None, None]:
    """Makes the trees, large ones first, and yields what happens; closing the iterator calls the rest off.

    There are never more trees out than workers, and a worker has no new one before the last one is here: what is lost
    with a worker is the tree that it was at. That is made again, up to three times.

    :raises ComputationError: when the scheduler is lost.
    """
    crew = _Crew(client, measure)
    pending, losses, begun = deque(sorted(orders, key=_effort, reverse=True)), Counter[str](), set[str]()
    deserted = False
    try:
        while pending or crew.out:
            n_workers = crew.n_workers()
            if n_workers == 0 and not deserted:
                yield Deserted()
            deserted = n_workers == 0
            while pending and len(crew.out) < n_workers:
                crew.send(pending.popleft())
            for happened in crew.happened():
                if isinstance(happened, Begun):
                    yield replace(happened, again=happened.name in begun)
                    begun.add(happened.name)
                elif not isinstance(happened, Lost):
                    yield happened
                elif losses[happened.order.name] < _TRIES_MORE:
                    losses[happened.order.name] += 1
                    pending.append(happened.order)
                else:
                    yield Finished(happened.order, Failed(_ALL_LOST))
    finally:
        crew.dismiss()


def _effort(order: Order) -> tuple[int, int]:
    """Trees that take longer compare higher, so that none of them is begun when all else is done."""
    return STAGES[order.config.method], order.config.n_terminals


class _Crew:
    """The workers as seen from here: trees that are ``out`` with them, and messages that came in."""

    def __init__(self, client: Client, measure: Measure) -> None:
        self.client, self.measure = client, measure
        self.out: dict[Future, Order] = {}
        self._topic = f"vascval-{secrets.token_hex(6)}"
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._n_workers, self._looked = 0, 0.0
        client.subscribe_topic(self._topic, lambda event: self._inbox.put(event[1]))

    def n_workers(self) -> int:
        """Trees that can be made at once, as of a moment ago."""
        if time.monotonic() - self._looked >= _SECONDS_BETWEEN_LOOKS:
            self._require_scheduler()
            self._n_workers, self._looked = n_threads(self.client), time.monotonic()
        return self._n_workers

    def send(self, order: Order) -> None:
        """Hands a tree out."""
        tell = partial(_tell, self._topic)
        future = self.client.submit(make, order, str(Path.cwd()), self.measure, tell, pure=False)
        self.out[future] = order
        future.add_done_callback(self._inbox.put)

    def happened(self) -> Iterator[Event | Lost]:
        """The next thing that happened, if anything does within a moment."""
        try:
            message = self._inbox.get(timeout=_SECONDS_BETWEEN_LOOKS)
        except queue.Empty:
            return
        if not isinstance(message, dict):
            order, result = self.out[message], _result(message)
            del self.out[message]
            message.release()
            yield Lost(order) if result is None else Finished(order, result)
        elif message["name"] in {order.name for order in self.out.values()}:
            if "begun_on" in message:
                yield Begun(message["name"], message["begun_on"])
            else:
                yield Share(message["name"], message["share"])

    def dismiss(self) -> None:
        """Calls off what is out."""
        if self.client.status == "running":
            self.client.cancel(list(self.out), force=True)
            self.client.unsubscribe_topic(self._topic)

    def _require_scheduler(self) -> None:
        if self.client.status != "running":
            raise ComputationError(_SCHEDULER_LOST)


def _result(future: Future) -> Grown | Failed | None:
    """What a worker made; nothing when it was lost."""
    from distributed import CancelledError, KilledWorker

    try:
        error = future.exception()
        if error is None:
            result: Grown | Failed = future.result()
            return result
    except CancelledError as lost:
        raise ComputationError(_SCHEDULER_LOST) from lost
    except KilledWorker as lost:
        error = lost
    if isinstance(error, KilledWorker):
        return None
    trace = "".join(traceback.format_exception(error))
    return Failed(f"internal error, {type(error).__name__}: {error}", trace)


def _tell(topic: str, message: dict[str, Any]) -> None:
    from distributed import get_worker

    get_worker().log_event(topic, message)

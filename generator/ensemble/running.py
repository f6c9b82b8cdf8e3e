"""Trees made by workers: handed out, watched and taken back as they are done."""

from __future__ import annotations

import queue
import secrets
import traceback
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from generator.ensemble.plan import Order
from generator.ensemble.work import Failed, Grown, Measure, make, warm_up
from generator.ensemble.workers import one_per_host
from vascval.core.errors import ComputationError

if TYPE_CHECKING:
    from distributed import Client, Future

_SECONDS_BETWEEN_LOOKS = 1.0


@dataclass(frozen=True)
class Started:
    """A worker began a tree; ``again`` after another was lost with it."""

    name: str
    worker: str
    again: bool


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


Event = Started | Share | Finished


def warm(client: Client, order: Order, measure: Measure) -> list[str]:
    """Compiles the kernels on one worker of each machine and waits; reasons why it could not be done."""
    futures = [
        client.submit(warm_up, order, str(Path.cwd()), measure, workers=[address], allow_other_workers=True, pure=False)
        for address in one_per_host(client)
    ]
    return [reason for reason in client.gather(futures) if reason]


def run(client: Client, orders: Sequence[Order], measure: Measure) -> Generator[Event, None, None]:
    """Makes the trees and yields what happens; closing the iterator calls the rest off.

    A tree whose worker is lost is made again by another, up to the number of times that the scheduler allows.

    :raises ComputationError: when the scheduler is lost.
    """
    run_id = secrets.token_hex(6)
    events: queue.SimpleQueue[Any] = queue.SimpleQueue()
    topic = f"vascval-{run_id}"
    client.subscribe_topic(topic, lambda event: events.put(event[1]))
    futures: dict[Future, Order] = {
        client.submit(
            make, order, str(Path.cwd()), measure, partial(_tell, topic), key=(f"tree-{run_id}", k), pure=False
        ): order
        for k, order in enumerate(orders)
    }
    try:
        for future in futures:
            future.add_done_callback(events.put)
        yield from _watched(client, events, futures)
    finally:
        if client.status == "running":
            client.cancel(list(futures), force=True)
            client.unsubscribe_topic(topic)


def _watched(
    client: Client, events: queue.SimpleQueue[Any], futures: dict[Future, Order]
) -> Generator[Event, None, None]:
    open_names = {order.name for order in futures.values()}
    begun: set[str] = set()
    while open_names:
        try:
            event = events.get(timeout=_SECONDS_BETWEEN_LOOKS)
        except queue.Empty:
            if client.status != "running":
                raise ComputationError(
                    "the scheduler was lost; call again once it is there to make the missing trees"
                ) from None
            continue
        if isinstance(event, dict):
            name = event["name"]
            if name not in open_names:
                continue
            if "begun_on" in event:
                yield Started(name, event["begun_on"], again=name in begun)
                begun.add(name)
            else:
                yield Share(name, event["share"])
        else:
            order = futures[event]
            result = _result(event)
            open_names.discard(order.name)
            yield Finished(order, result)
            event.release()


def _result(future: Future) -> Grown | Failed:
    from distributed import CancelledError, KilledWorker

    error = future.exception()
    if error is None:
        result: Grown | Failed = future.result()
        return result
    if isinstance(error, KilledWorker):
        return Failed("every worker that made it was lost; the machine may be short of memory")
    if isinstance(error, CancelledError):
        raise ComputationError("the scheduler was lost; call again once it is there to make the missing trees")
    trace = "".join(traceback.format_exception(error))
    return Failed(f"internal error, {type(error).__name__}: {error}", trace)


def _tell(topic: str, message: dict[str, Any]) -> None:
    from distributed import get_worker

    get_worker().log_event(topic, message)

"""Workers: processes on this machine, or those of a Dask scheduler elsewhere. One way to both: a Dask client."""

from __future__ import annotations

import asyncio
import logging
import re
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from vascval.core.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

_ADDRESS = re.compile(r"((tcp|tls|ucx|wss?)://)?[^/\s]+:\d+/?")
_SECONDS_TO_CONNECT = 15
_SECONDS_FOR_WORKERS = 60


@contextmanager
def connected(scheduler: str | None, n_workers: int) -> Iterator[Client]:
    """A client of the scheduler at that address, or of one started here with ``n_workers`` processes.

    Local processes have one thread each, are started again when they are lost, and end with the context. At least one
    worker is there.

    :raises InputError: when no scheduler answers or it has no workers.
    """
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)  # what was under way when a client is closed is no news
    if scheduler is None:
        with _local(n_workers) as client:
            yield client
    else:
        with _remote(scheduler) as client:
            yield client


@contextmanager
def _local(n_workers: int) -> Iterator[Client]:
    import dask
    from distributed import Client, LocalCluster

    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": 0,  # a tree whose worker was lost comes back at once
        # nobody looks at these, and they take 1 % of each worker
        "distributed.worker.profile.enabled": False,
        "distributed.admin.system-monitor.interval": "5s",
    }
    options: dict[str, Any] = {"preload": [__name__], "memory_limit": 0, "silence_logs": logging.CRITICAL}
    with dask.config.set(settings):
        with _deaf_to_ctrl_c():
            cluster = LocalCluster(
                n_workers=n_workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", **options
            )
        with cluster, Client(cluster) as client:
            yield client


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Threads and processes that are begun within never hear it, from their first moment on."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # which lets the thread that starts it hear again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _remote(address: str) -> Iterator[Client]:
    if not _ADDRESS.fullmatch(address):
        raise InputError(f"--scheduler {address}: is no address; write tcp://HOST:PORT as 'dask scheduler' prints it")
    from distributed import Client

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            client = Client(address, timeout=_SECONDS_TO_CONNECT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers ({reason}); start one by 'dask scheduler' "
            "and give the address that it prints"
        ) from error
    try:
        try:
            client.wait_for_workers(1, timeout=_SECONDS_FOR_WORKERS)
        except (TimeoutError, asyncio.TimeoutError) as error:
            raise InputError(
                f"--scheduler {address}: the scheduler has no workers; start some by 'dask worker {address}'"
            ) from error
        yield client
    finally:
        client.close()


def n_threads(client: Client) -> int:
    """How many trees the workers make at once."""
    return sum(client.nthreads().values())


def by_host(client: Client) -> list[list[str]]:
    """The addresses of the workers on each machine."""
    hosts: dict[str, list[str]] = {}
    for address, worker in sorted(client.scheduler_info(n_workers=-1)["workers"].items()):
        hosts.setdefault(worker["host"], []).append(address)
    return list(hosts.values())


def dask_setup(_worker: object) -> None:
    """Run by each local worker as it starts: Ctrl-C is for the program that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

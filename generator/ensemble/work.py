"""What a worker does: make one tree, measure it, and hand both back as bytes. Nothing stays on the worker."""

from __future__ import annotations

import os
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from numba.core import event

import vascval
from generator.code_checksum import code_sha256
from generator.config import Config
from generator.ensemble.plan import CODE, Order, identity
from generator.framework import Run, read_points
from vascval.core.errors import InputError, VascvalError
from vascval.core.threads import VARIABLE
from vascval.core.tree import Tree
from vascval.core.validation import Claims
from vascval.io.provenance import provenance
from vascval.io.trees import write_tree

Measure = Callable[[Tree, str], dict[str, Any]]
"""Takes a tree and what it is called, gives a JSON document. A function that can be pickled by its name."""
Report = Callable[[dict[str, Any]], None]
_SECONDS_BETWEEN_REPORTS = 0.5
STAGES = {"cco": 1, "geometry": 2, "full": 3}
"""How many each method has."""


@dataclass(frozen=True)
class Grown:
    """A tree made: ``vtp`` is its file, byte for byte that of ``vascval generate``; ``document`` what was measured,
    with the stages and the provenance; ``worker`` and ``seconds`` say where and how long."""

    vtp: bytes
    document: dict[str, Any]
    worker: str
    seconds: float


@dataclass(frozen=True)
class Failed:
    """A tree that could not be made, and why; ``trace`` of an error that nobody foresaw."""

    reason: str
    trace: str = ""


def make(order: Order, folder: str, measure: Measure, report: Report) -> Grown | Failed:
    """One tree, on one thread unless ``VASCVAL_THREADS`` says otherwise.

    :param folder: where relative file names of the configuration begin.
    :param report: told ``{"name", "begun_on"}`` at the beginning and then ``{"name", "share"}`` now and then, the share
        that is done.
    """
    os.environ.setdefault(VARIABLE, "1")
    began = time.perf_counter()
    worker = f"{socket.gethostname()}:{os.getpid()}"
    report({"name": order.name, "begun_on": worker})
    try:
        run = Run.of(_found(order, Path(folder)))
        _drive(run, order.name, report)
        tree = run.tree()
        config = order.config
        origin = provenance(
            command="generate", config=config.model_dump(mode="json"), seed=config.seed, inputs=run.inputs()
        )
        document = {
            **measure(tree, f"{order.name}.vtp"),
            "seed": config.seed,
            "stages": [
                {name: value for name, value in asdict(stage).items() if value is not None} for stage in run.stages
            ],
            "provenance": origin,
        }
        return Grown(_file(tree, origin, run.claims(tree)), document, worker, time.perf_counter() - began)
    except VascvalError as error:
        return Failed(str(error))


def warm_up(order: Order, folder: str, measure: Measure, compiles: bool) -> str:
    """Makes a tiny tree of that kind, so that this process has the kernels and all that is imported on the way.

    :param compiles: compile those that are not in the user's cache, and put them there; else stop at the first.
    :returns: why it could not be done, or nothing.
    """
    os.environ.setdefault(VARIABLE, "1")
    try:
        with nullcontext() if compiles else _nothing_compiled():
            run = Run.of(_tiny(_found(order, Path(folder))))
            for _ in run.steps():
                pass
            tree = run.tree()
            measure(tree, order.name)
            _file(tree, {}, run.claims(tree))
    except VascvalError as error:
        return str(error)
    except _NotCached:
        pass
    return ""


class _NotCached(Exception):
    """A kernel would have to be compiled."""


class _Refusal(event.Listener):  # type: ignore[misc]
    def on_start(self, event: event.Event) -> None:
        raise _NotCached

    def on_end(self, event: event.Event) -> None:
        """A compilation that was refused."""


@contextmanager
def _nothing_compiled() -> Iterator[None]:
    """:raises _NotCached: where a kernel would be compiled inside."""
    with event.install_listener("numba:compile", _Refusal()):
        yield


def _tiny(config: Config) -> Config:
    """The same kind of tree with a few terminals."""
    changes: dict[str, Any] = {"n_terminals": min(config.n_terminals, 12)}
    if config.terminals_file is not None:
        changes |= {"terminals_file": None, "root_mm": tuple(read_points(config.terminals_file)[0])}
    topology = config.topology.model_copy(update={"at": 6, "tests": 200})
    return config.model_copy(update={**changes, "topology": topology})


def _found(order: Order, folder: Path) -> Config:
    """The configuration with full file names, the files being the ones that were meant.

    :raises InputError: when this machine has another version of the program, lacks a file or has another one.
    """
    if order.identity["version"] != vascval.__version__:
        raise InputError(
            f"the worker on {socket.gethostname()} has vascval {vascval.__version__}, not {order.identity['version']}; "
            "install the same version"
        )
    if order.identity[CODE] != f"sha256 {code_sha256()}":
        raise InputError(
            f"the worker on {socket.gethostname()} has other sources of vascval {vascval.__version__}; install the "
            "same, and start the worker anew"
        )
    config = order.config
    files = {name: folder / path for name in ("root_tree", "terminals_file") if (path := getattr(config, name))}
    domain = config.domain
    if domain.file is not None:
        domain = domain.model_copy(update={"file": folder / domain.file})
    config = config.model_copy(update={**files, "domain": domain})
    here = identity(config) if files or domain.file is not None else order.identity
    for key, value in here.items():
        if value != order.identity[key]:
            raise InputError(f"{key}: the file on {socket.gethostname()} is another one; make them the same")
    return config


def _drive(run: Run, name: str, report: Report) -> None:
    """Runs all stages. Growth, topology and geometry count alike in the share that is done."""
    done: dict[str, float] = {}
    last = time.perf_counter()
    for stage, step in run.steps():
        if stage in done or step.n_target:
            done[stage] = step.n_terminals / max(step.n_target, 1)
        if time.perf_counter() - last >= _SECONDS_BETWEEN_REPORTS:
            last = time.perf_counter()
            report({"name": name, "share": min(sum(done.values()) / STAGES[run.config.method], 1.0)})


def _file(tree: Tree, origin: dict[str, Any], claims: Claims) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tree.vtp"
        write_tree(tree, path, provenance=origin, claims=claims)
        return path.read_bytes()

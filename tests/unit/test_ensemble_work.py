"""What workers do, and what becomes of trees whose workers are lost."""

import os
import signal
import subprocess
import sys

import pytest

from generator.ensemble import running, work
from generator.ensemble.plan import Order, plan
from generator.ensemble.running import Begun, Deserted, Finished, run, warm
from generator.ensemble.work import Failed, Grown, make, warm_up
from generator.ensemble.workers import by_host, connected, n_threads
from vascval.core.errors import ComputationError, InputError
from vascval.core.threads import threads
from vascval.core.tree import Tree

POISON = 3


def volume(tree: Tree, source: str) -> dict:
    return {"source": source, "volume_mm3": tree.volume_mm3}


def deadly(tree: Tree, source: str) -> dict:
    """Ends the process that measures one of the trees."""
    if source == f"seed-{POISON}.vtp":
        os.kill(os.getpid(), signal.SIGKILL)
    return volume(tree, source)


def broken(tree: Tree, source: str) -> dict:
    raise KeyError(source)


def orders(*changes: str, seeds=4):
    return plan("karch-box", ("n_terminals=60", *changes), (), seeds).orders


@pytest.fixture(autouse=True)
def one_thread(monkeypatch):
    """So that what workers set for themselves does not stay here."""
    monkeypatch.setenv("VASCVAL_THREADS", "1")


@pytest.fixture(scope="module")
def client():
    with connected(None, 2) as client:
        yield client


@pytest.mark.parametrize("method", ["cco", "geometry", "full"])
def test_progress_goes_from_nothing_to_all(method, monkeypatch, tmp_path):
    monkeypatch.setattr(work, "_SECONDS_BETWEEN_REPORTS", 0.0)
    told: list[dict] = []
    n_terminals = 1500 if method == "cco" else 60
    order = orders(f"method={method}", f"n_terminals={n_terminals}", "topology.at=8", "topology.tests=2000")[0]
    result = make(order, str(tmp_path), volume, told.append)
    assert isinstance(result, Grown)
    assert told[0] == {"name": "seed-1", "begun_on": result.worker}
    shares = [message["share"] for message in told[1:]]
    assert len(shares) > 1
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < 1.0
    assert shares[-1] == pytest.approx(1.0)
    assert result.document["volume_mm3"] == pytest.approx(result.document["stages"][-1]["volume_mm3"], rel=1e-12)
    assert result.document["provenance"]["seed"] == result.document["seed"] == 1


def test_workers_do_not_trust_their_files(tmp_path, monkeypatch):
    here, there = tmp_path / "here", tmp_path / "there"
    for folder, last in ((here, 9), (there, 8)):
        folder.mkdir()
        (folder / "points.csv").write_text(f"x_mm,y_mm,z_mm\n0,0,0\n5,5,5\n9,9,{last}\n")
    monkeypatch.chdir(here)
    (order,) = orders("terminals_file=points.csv", seeds=1)
    assert isinstance(make(order, str(here), volume, lambda _: None), Grown)
    assert warm_up(order, str(here), volume, True) == ""
    other = make(order, str(there), volume, lambda _: None)
    assert isinstance(other, Failed) and "terminals_file: the file on" in other.reason
    gone = make(order, str(tmp_path), volume, lambda _: None)
    assert isinstance(gone, Failed) and "points.csv: cannot be read" in gone.reason
    assert "points.csv: cannot be read" in warm_up(order, str(tmp_path), volume, True)


def test_a_worker_that_may_not_compile_loads_what_there_is(tmp_path):
    """In a process of its own, once the kernels are in the cache: it gets as far as the measures, and there stops at
    a kernel that was never compiled. One that may compile goes on."""
    (order,) = orders(seeds=1)
    assert warm_up(order, str(tmp_path), volume, True) == ""
    script = (
        "import numba\n"
        "from generator.ensemble.plan import plan\n"
        "from generator.ensemble.work import warm_up\n"
        "reached = []\n"
        "def measure(tree, source):\n"
        "    reached.append('loaded')\n"
        "    reached.append(numba.njit(lambda n: n + 1)(tree.n_nodes) - tree.n_nodes)\n"
        "order = plan('karch-box', ('n_terminals=60',), (), 1).orders[0]\n"
        "print([warm_up(order, '.', measure, compiles) for compiles in (False, True)], reached)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "['', ''] ['loaded', 'loaded', 1]\n"


def test_workers_are_of_the_same_version(tmp_path):
    order = orders()[0]
    newer = Order(order.name, order.case, order.config, {**order.identity, "version": "99"})
    result = make(newer, str(tmp_path), volume, lambda _: None)
    assert isinstance(result, Failed) and "has vascval" in result.reason and "not 99" in result.reason
    other = Order(order.name, order.case, order.config, {**order.identity, "code": "sha256 0"})
    result = make(other, str(tmp_path), volume, lambda _: None)
    assert isinstance(result, Failed) and "has other sources of vascval" in result.reason


def test_a_worker_lost_costs_its_own_tree(client):
    """A tree that ends every worker fails in the end; the others are made, each by one worker."""
    wanted = orders(seeds=8)
    assert n_threads(client) == 2
    assert [len(workers) for workers in by_host(client)] == [2]
    assert warm(client, wanted[0], volume) == []
    events = list(run(client, wanted, deadly))
    results = {event.order.config.seed: event.result for event in events if isinstance(event, Finished)}
    assert sorted(results) == [order.config.seed for order in wanted]
    assert isinstance(results[POISON], Failed)
    assert "every worker that made it was lost" in results[POISON].reason
    assert [seed for seed, result in results.items() if not isinstance(result, Grown)] == [POISON]
    again = [event.name for event in events if isinstance(event, Begun) and event.again]
    assert set(again) == {f"seed-{POISON}"}
    assert len({result.worker for result in results.values() if isinstance(result, Grown)}) > 1


def test_large_trees_are_handed_out_first(client, monkeypatch):
    """Of all methods the slowest, and of those the largest."""
    wanted = plan("karch-box", ("topology.tests=50",), ("n_terminals=6,60", "method=cco,full"), 1).orders
    send, sent = running._Crew.send, []
    monkeypatch.setattr(running._Crew, "send", lambda crew, order: (sent.append(order.config), send(crew, order)))
    made = [event.order.name for event in run(client, wanted, volume) if isinstance(event, Finished)]
    assert sorted(made) == sorted(order.name for order in wanted)
    assert [(config.method, config.n_terminals) for config in sent] == [
        ("full", 60),
        ("full", 6),
        ("cco", 60),
        ("cco", 6),
    ]


def test_errors_that_nobody_foresaw_are_told(client):
    (order,) = orders(seeds=1)
    (event,) = (event for event in run(client, [order], broken) if isinstance(event, Finished))
    assert isinstance(event.result, Failed)
    assert event.result.reason == "internal error, KeyError: 'seed-1.vtp'"
    assert "in broken" in event.result.trace


def test_calling_off_leaves_the_workers_free(client):
    events = run(client, orders(seeds=40), volume)
    next(events)
    events.close()
    (finished,) = (event for event in run(client, orders(seeds=1), volume) if isinstance(event, Finished))
    assert isinstance(finished.result, Grown)


class Deserters:
    """A client whose workers have gone, and then the scheduler."""

    def __init__(self) -> None:
        self.status, self.looks = "running", 0

    def nthreads(self) -> dict:
        self.looks += 1
        self.status = "running" if self.looks < 3 else "closed"
        return {}

    def subscribe_topic(self, topic: str, handler: object) -> None:
        pass


def test_without_workers_it_waits_and_without_a_scheduler_it_ends(monkeypatch):
    monkeypatch.setattr(running, "_SECONDS_BETWEEN_LOOKS", 0.01)
    events = run(Deserters(), orders(), volume)  # type: ignore[arg-type]
    assert next(events) == Deserted()
    with pytest.raises(ComputationError, match="the scheduler was lost; call again"):
        next(events)


@pytest.mark.parametrize(("set_there", "used"), [(None, 1), ("2", 2)])
def test_a_tree_uses_one_thread_unless_told_otherwise(set_there, used, monkeypatch, tmp_path):
    monkeypatch.delenv("VASCVAL_THREADS")
    if set_there is not None:
        monkeypatch.setenv("VASCVAL_THREADS", set_there)
    assert isinstance(make(orders()[0], str(tmp_path), volume, lambda _: None), Grown)
    assert threads() == used


@pytest.mark.parametrize("address", ["nonsense", "host", "smtp://host:25", "tcp://host", ""])
def test_addresses(address):
    with pytest.raises(InputError, match="is no address; write tcp://HOST:PORT"), connected(address, 1):
        pass

"""``python -m tests.mutation MODULE [...]``: change a module in small ways, and see which changes no test notices.

Each mutant runs the tests of its module in a process forked from one in which all libraries are loaded, kernels being
plain Python (``NUMBA_DISABLE_JIT``). What survives is printed unless ``README.md`` here explains it; exit code 1 then.
"""

from __future__ import annotations

import argparse
import importlib.abc
import importlib.util
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import CodeType, ModuleType

from tests.mutation.mutants import Mutant, mutants

ROOT = Path(__file__).resolve().parents[2]
README = Path(__file__).with_name("README.md")
FLOW = ["tests/property/test_haemodynamics_property.py"]
ORDERS = ["tests/property/test_ordering_property.py", "tests/unit/test_core.py"]
TESTS = {
    "generator.haemodynamics": FLOW,
    "generator._haemodynamics_kernels": FLOW,
    "vascval.core.ordering": ORDERS,
    "vascval.core._ordering_kernels": ORDERS,
    "vascval.morphometry.orders": ["tests/unit/test_morphometry_orders.py"],
}
_LIBRARIES = (
    "numpy", "numba", "pandas", "scipy.spatial", "scipy.optimize", "scipy.sparse.csgraph", "pydantic", "pytest",
    "hypothesis", "hypothesis.strategies", "hypothesis.extra.numpy", "_pytest.assertion.rewrite",
)  # fmt: skip


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from other code than its file holds."""

    def __init__(self, name: str, path: Path, code: CodeType) -> None:
        self._name, self._path, self._code = name, path, code

    def find_spec(self, name: str, path: object, target: object = None) -> object:
        if name != self._name:
            return None
        return importlib.util.spec_from_file_location(name, self._path, loader=self)  # type: ignore[arg-type]

    def create_module(self, spec: object) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        exec(self._code, module.__dict__)


def verdict(name: str, mutant: Mutant, tests: Sequence[str], timeout_s: float) -> str:
    """``killed``, ``timeout`` (which counts as killed) or ``survived``."""
    path = ROOT / (name.replace(".", "/") + ".py")
    child = os.fork()
    if child == 0:
        os.setsid()
        silence = os.open(os.devnull, os.O_RDWR)
        for number in (1, 2):
            os.dup2(silence, number)
        try:
            sys.meta_path.insert(0, Changed(name, path, compile(mutant.tree, str(path), "exec")))
            import pytest

            code = pytest.main(["-x", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no", *tests])
        except BaseException:  # noqa: BLE001
            code = 1
        os._exit(0 if code == 0 else 1)
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return "killed" if status else "survived"
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "timeout"


def explained() -> str:
    return README.read_text(encoding="utf-8") if README.exists() else ""


def run(name: str, only: str, limit: int) -> list[str]:
    """The keys of the survivors of a module that are not explained."""
    source = (ROOT / (name.replace(".", "/") + ".py")).read_text(encoding="utf-8")
    chosen = [mutant for mutant in mutants(source) if only in mutant.key][:limit]
    unchanged = Mutant("unchanged", __import__("ast").parse(source))
    begin = time.monotonic()
    if verdict(name, unchanged, TESTS[name], 600.0) != "survived":
        sys.exit(f"{name}: its tests fail without any change; run them by pytest first")
    timeout = 10.0 + 5 * (time.monotonic() - begin)
    counts = {"killed": 0, "timeout": 0, "survived": 0, "explained": 0}
    known, left = explained(), []
    for mutant in chosen:
        result = verdict(name, mutant, TESTS[name], timeout)
        if result == "survived" and f"`{mutant.key}`" in known:
            result = "explained"
        counts[result] += 1
        if result == "survived":
            left.append(mutant.key)
            print(f"{name}: survived: {mutant.key}", flush=True)
    print(f"{name}: {len(chosen)} mutants: " + ", ".join(f"{n} {what}" for what, n in counts.items()), flush=True)
    return left


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=f"of {', '.join(TESTS)}; default: all")
    parser.add_argument("--only", default="", help="mutants whose key holds this text")
    parser.add_argument("--limit", type=int, default=sys.maxsize, help="of mutants of each module")
    given = parser.parse_args()
    unknown = sorted(set(given.modules) - set(TESTS))
    if unknown:
        parser.error(f"no tests are listed for {', '.join(unknown)}; there are {', '.join(TESTS)}")
    os.chdir(ROOT)
    os.environ.update(NUMBA_DISABLE_JIT="1", HYPOTHESIS_STORAGE_DIRECTORY=os.devnull)
    for library in _LIBRARIES:
        importlib.import_module(library)
    from hypothesis import Phase, settings

    # a failure is enough: it need not be the smallest, nor is it kept
    settings.register_profile("mutation", phases=(Phase.explicit, Phase.generate), database=None)
    settings.load_profile("mutation")
    left = [key for name in given.modules or TESTS for key in run(name, given.only, given.limit)]
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())

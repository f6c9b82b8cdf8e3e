"""``python -m tests.fuzz [TARGET ...] [--seconds N] [--seed N] [--save DIR]``: fuzz readers for as long as you like.

Every target gets its share of ``--seconds``. Files that show a fault are saved under ``--save`` by target; put them
into ``tests/fuzz/corpus`` once the fault is mended, where the tests replay them. Exit code 1 when there was a fault.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from pathlib import Path

from tests.fuzz.targets import TARGETS
from tests.fuzz.watch import Finding, corpus, fuzz, replay


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; default: all")
    parser.add_argument("--seconds", type=float, default=60.0, help="in total (default 60)")
    parser.add_argument("--cases", type=int, default=sys.maxsize, help="of each target at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path, default=Path("fuzz-findings"), help="where files that show a fault go")
    parser.add_argument("--replay", action="store_true", help="read the corpus of earlier findings and nothing else")
    given = parser.parse_args()
    unknown = sorted(set(given.targets) - set(TARGETS))
    if unknown:
        parser.error(f"no target {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    names = given.targets or list(TARGETS)
    found = 0
    items = replay(corpus()) if given.replay else fuzz(
        names, seed=given.seed, cases=given.cases, seconds=given.seconds / len(names)
    )  # fmt: skip
    for item in items:
        if isinstance(item, Finding):
            found += 1
            print(f"{item.target}: {item.said}")
            folder = given.save / item.target
            folder.mkdir(parents=True, exist_ok=True)
            (folder / hashlib.sha256(item.data).hexdigest()[:12]).write_bytes(item.data)
        else:
            print(f"{item['done']}: {item['cases']} cases, {item['edges']} edges, {item['pool']} inputs reached new "
                  f"code, slowest {item['slowest_s']:.2f} s of CPU")  # fmt: skip
        sys.stdout.flush()
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

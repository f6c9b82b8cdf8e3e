"""The manifest: which trees of an ensemble there are, so that a second call makes only those that are missing."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from generator.ensemble.plan import CODE, Order, Plan, digest
from generator.ensemble.work import Failed, Grown
from vascval.core.errors import InputError
from vascval.io.atomic import atomic_file
from vascval.io.ensembles import ManifestDocument, ManifestTree

MISSING, DONE, FAILED = "missing", "done", "failed"


@dataclass
class Manifest:
    """What there is of an ensemble in ``folder``; written to ``path`` after every change."""

    path: Path
    folder: Path
    base: dict[str, Any]
    trees: dict[str, ManifestTree] = field(default_factory=dict)

    @classmethod
    def of(cls, plan: Plan, path: Path, folder: Path) -> Manifest:
        """The manifest at ``path``, or a new one, with every tree of the plan in it.

        Trees that are there and not in the plan stay. A tree whose files are gone or damaged is missing.

        :raises InputError: when it is unreadable or belongs to another configuration or version.
        """
        manifest = cls(path, folder, plan.base)
        if path.exists():
            planned = {order.name: order.digest for order in plan.orders}
            for tree in _read(path, plan.base).trees:
                if planned.get(tree.name, tree.config_sha256) == tree.config_sha256:
                    manifest.trees[tree.config_sha256] = tree
        for order in plan.orders:
            known = manifest.trees.get(order.digest)
            if known is None:
                manifest.trees[order.digest] = ManifestTree(
                    name=order.name, case=order.case, seed=order.config.seed, config_sha256=order.digest, state=MISSING
                )
            elif known.state == DONE and not manifest._intact(known):
                manifest.trees[order.digest] = _emptied(known)
        return manifest

    def tree(self, order: Order) -> ManifestTree:
        """The entry of a tree of the plan."""
        return self.trees[order.digest]

    def missing(self, plan: Plan) -> list[Order]:
        """The trees of the plan that are still to be made; those that failed are tried again."""
        return [order for order in plan.orders if self.tree(order).state != DONE]

    def document(self, order: Order) -> dict[str, Any]:
        """What was measured on a tree that is done."""
        document: dict[str, Any] = json.loads(self._measures(self.tree(order)).read_text(encoding="utf-8"))
        return document

    def file(self, tree: ManifestTree) -> Path:
        """Where the tree is."""
        return self.folder / "trees" / f"{tree.name}.vtp"

    def _measures(self, tree: ManifestTree) -> Path:
        return self.folder / "trees" / f"{tree.name}.json"

    def keep(self, order: Order, result: Grown | Failed) -> None:
        """Writes the files of a tree, then the manifest that names them."""
        tree = self.tree(order)
        if isinstance(result, Failed):
            self.trees[order.digest] = _emptied(tree, state=FAILED, error=result.reason)
        else:
            (self.folder / "trees").mkdir(exist_ok=True)
            measures = (json.dumps(result.document, indent=1, allow_nan=False) + "\n").encode()
            for path, content in ((self.file(tree), result.vtp), (self._measures(tree), measures)):
                with atomic_file(path) as aside:
                    aside.write_bytes(content)
            self.trees[order.digest] = _emptied(
                tree, state=DONE, sha256=_sha256(result.vtp), measures_sha256=_sha256(measures),
                seconds=result.seconds, worker=result.worker,
            )  # fmt: skip
        self.write()

    def write(self) -> None:
        """All of it, or the old one stays."""
        document = ManifestDocument(
            version=self.base["version"],
            config_sha256=digest(self.base),
            config=self.base,
            trees=list(self.trees.values()),
        )
        with atomic_file(self.path) as aside:
            aside.write_text(document.model_dump_json(indent=1) + "\n", encoding="utf-8")

    def _intact(self, tree: ManifestTree) -> bool:
        return all(
            path.is_file() and _sha256(path.read_bytes()) == expected
            for path, expected in ((self.file(tree), tree.sha256), (self._measures(tree), tree.measures_sha256))
        )


def _emptied(tree: ManifestTree, **content: Any) -> ManifestTree:
    """The entry with nothing but what names the tree, and ``content``."""
    named = {name: getattr(tree, name) for name in ("name", "case", "seed", "config_sha256")}
    return ManifestTree(**{**named, "state": MISSING, **content})


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _read(path: Path, base: Mapping[str, Any]) -> ManifestDocument:
    try:
        document = ManifestDocument.model_validate_json(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); choose another directory") from None
    except ValidationError:
        raise InputError(f"{path}: is no manifest of an ensemble; move it away or choose another directory") from None
    if document.config_sha256 != digest(base):
        raise InputError(f"{path}: is of another ensemble: {_difference(document.config, base)}; choose another -o")
    return document


def _difference(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The first key that differs, and how many more do."""
    keys = [key for key in {**now, **before} if before.get(key) != now.get(key)]
    if not keys:
        return "its checksum is not that of its configuration"
    key = keys[0]
    more = f" ({len(keys) - 1} more)" if len(keys) > 1 else ""
    if key == CODE:
        return f"its trees were made by other sources of vascval {now['version']}{more}"
    if str(now.get(key)).startswith("sha256 ") and str(before.get(key)).startswith("sha256 "):
        return f"the file of {key} was another one{more}"
    return f"{key} was {before.get(key, 'not known')} and is {now.get(key, 'not known')}{more}"

"""The parts of ``vascval twin``: the perfusion volume, where the trees begin in it, and the trees."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vascval.cli import sources
from vascval.cli.console import Observer
from vascval.cli.keeping import Keeping, grow
from vascval.core.errors import InputError

if TYPE_CHECKING:
    from generator.config import Config
    from generator.domain import Domain
    from generator.framework import Run
    from vascval.cli.twin_kept import Parts
    from vascval.comparison.perfusion import Entry
    from vascval.core.tree import Tree
    from vascval.io.volumes import Volume
    from vascval.report.scene import Surface

PRESET = "portal-vein"
TREES = {"cco": "cco", "optimised": "full"}
"""What the grown trees are called, and the method of each."""
_DECIDED = {
    "method": "both methods are grown",
    "root_mm": "use --root",
    "root_tree": "use --root-generations",
    "terminals_file": "terminals are drawn from the perfusion volume",
    "domain.file": "use --domain",
    "domain.box_mm": "use --domain",
    "domain.shape": "use --domain",
}
_OF_A_FILE = ("domain.label", "domain.closing_mm", "domain.keep")
_LEAST_INSIDE = 0.5
_THICKENING = 1.5
_TRIED = 100_000
TISSUE_POINTS = 20_000


@dataclass(frozen=True, eq=False)
class Ground:
    """The perfusion volume as the trees see it, how it was made (:class:`vascval.io.twins.TwinDomain`), its surface."""

    domain: Domain
    file: Path
    facts: dict[str, Any]
    surface: Surface | None


def configurations(changes: Sequence[str], has_file: bool) -> dict[str, Config]:
    """The configuration of each grown tree, from the preset and the user's ``changes``.

    :param has_file: whether the perfusion volume is read from a file.
    :raises InputError: also for a change of what the twin itself decides, or of how a file is read where there is none.
    """
    from generator.config import load

    for change in changes:
        key = change.partition("=")[0].strip()
        if key in _DECIDED:
            raise InputError(f"--set {change}: {key} is decided by the twin; {_DECIDED[key]}")
        if key in _OF_A_FILE and not has_file:
            raise InputError(
                f"--set {change}: says how a perfusion volume is read, and here it is the hull of the cast; give a "
                "file with --domain, or leave it out"
            )
    return {name: load(PRESET, [*changes, f"method={method}"]) for name, method in TREES.items()}


def given_ground(path: Path, config: Config, cast: Tree, folder: Path) -> Ground:
    """A perfusion volume from a file; what was carved out of a volume around the cast's vessels is closed.

    It is written into ``folder`` as the trees see it: closed, cropped and in one piece.
    """
    from generator.config import DomainConfig
    from generator.domains import make_domain
    from generator.surface_files import read_surface
    from vascval.io.trees import is_volume_path
    from vascval.io.volumes import read_volume, write_volume
    from vascval.report.scene import Surface, mask_surface

    is_volume = is_volume_path(path)
    asked = config.domain
    closing = asked.closing_mm if "closing_mm" in asked.model_fields_set else float(cast.radius_mm.max())
    closing *= is_volume
    made = make_domain(DomainConfig(file=path, label=asked.label, closing_mm=closing, keep=asked.keep))
    name = "domain.nrrd" if is_volume else f"domain{path.suffix.lower()}"
    if is_volume:
        mask = _as_mask(made, read_volume(path))
        write_volume(mask, folder / name)
        domain, surface = make_domain(DomainConfig(file=folder / name)), mask_surface(mask)
    else:
        shutil.copyfile(path, folder / name)
        domain, surface = made, Surface(*read_surface(path))
    domain.notes = made.notes
    kind = "volume" if is_volume else "surface"
    return _ground(domain, folder / name, surface, kind=kind, source=path.name, closing_mm=closing, margin_mm=0.0)


def hull_ground(cast: Tree, source: Path, radius_mm: float | None, margin_mm: float | None, folder: Path) -> Ground:
    """The hull of the cast (:func:`vascval.imaging.perfusion_volume.perfusion_volume`), written into ``folder``."""
    from generator.config import DomainConfig
    from generator.domains import make_domain
    from vascval.imaging.perfusion_volume import perfusion_volume
    from vascval.io.volumes import write_volume
    from vascval.report.scene import mask_surface

    with sources.about(source):
        hull = perfusion_volume(cast, radius_mm=radius_mm, margin_mm=margin_mm)
    write_volume(hull.mask, folder / "domain.nrrd")
    domain = make_domain(DomainConfig(file=folder / "domain.nrrd"))
    if hull.n_voids_filled:
        domain.notes = (*domain.notes, f"{hull.n_voids_filled} voids of the hull were filled")
    return _ground(
        domain, folder / "domain.nrrd", mask_surface(hull.mask), kind="hull", source=source.name,
        closing_mm=hull.radius_mm, margin_mm=hull.margin_mm,
    )  # fmt: skip


def _ground(domain: Domain, file: Path, surface: Surface | None, **facts: Any) -> Ground:
    from dataclasses import replace

    named = None if surface is None else replace(surface, label="perfusion volume", voxel_mm=0.0, opacity=0.18)
    return Ground(domain, file, {**facts, "file": file.name, "volume_mm3": domain.volume_mm3}, named)


def _as_mask(domain: Domain, volume: Volume) -> Volume:
    """The domain on the grid of the volume that it came from, cropped to it."""
    from vascval.io.volumes import Volume

    size = np.array(volume.values.shape[::-1])
    corners = np.array(np.meshgrid(*zip(domain.lower_mm, domain.upper_mm, strict=True))).reshape(3, -1).T
    index = volume.to_index(corners)
    low = np.clip(np.floor(index.min(axis=0)).astype(int), 0, size)
    high = np.clip(np.ceil(index.max(axis=0)).astype(int) + 1, 0, size)
    y, x = np.meshgrid(np.arange(low[1], high[1]), np.arange(low[0], high[0]), indexing="ij")
    mask = np.zeros((high - low)[::-1], dtype=np.uint8)
    for z in range(low[2], high[2]):
        plane = np.stack((x, y, np.full_like(x, z)), axis=-1).reshape(-1, 3)
        mask[z - low[2]] = domain.contains(volume.to_world(plane)).reshape(x.shape)
    return Volume(mask, volume.spacing_mm, volume.to_world(low), volume.direction)


@dataclass(frozen=True, eq=False)
class Start:
    """Where the grown trees begin: ``cast`` as it is compared, the root, and sentences on both."""

    cast: Tree
    root_mm: np.ndarray
    moved_mm: float
    shares: dict[str, float]
    notes: list[str]


def start(cast: Tree, path: Path, ground: Ground) -> Start:
    """The cast from where it enters the perfusion volume on, and the root of the grown trees.

    :raises InputError: when little or nothing of the cast is inside.
    """
    from vascval.comparison.perfusion import enter, shares_inside

    contains = ground.domain.contains
    where = ground.facts["source"]
    with sources.about(path):
        entry = enter(cast, contains)
        whole, kept = shares_inside(cast, contains), shares_inside(entry.tree, contains)
        if kept.length < _LEAST_INSIDE:
            raise InputError(
                f"only {kept.length:.1%} of the cast's length lies in {where}, and of its terminals "
                f"{kept.terminals:.1%}; give the tissue that it supplies, in the same world frame, or leave --domain "
                "out for a hull of the cast"
            )
    root, notes = _root(cast, entry, ground.domain, where)
    notes += _thickening(entry.tree)
    if kept.length < 1.0:
        notes.append(
            f"{1 - kept.length:.1%} of the length of the cast that is compared, and {1 - kept.terminals:.1%} of its "
            f"terminals, lie outside {where}"
        )
    moved = 0.0 if entry.at_wall else float(np.linalg.norm(root - entry.tree.position_mm[1]))
    shares = {"length_inside_share_given": whole.length}
    shares |= {f"{name}_inside_share": value for name, value in asdict(kept).items()}
    return Start(entry.tree, root, moved, shares, notes)


def _root(cast: Tree, entry: Entry, domain: Domain, where: str) -> tuple[np.ndarray, list[str]]:
    """The root of the grown trees, inside, and what there is to say about it."""
    root = entry.tree.position_mm[0]
    if not entry.cut:
        return root, []
    left = cast.topology.n_terminals - entry.tree.topology.n_terminals
    out = -float(domain.wall_distance_mm(cast.position_mm[:1])[0])
    notes = [
        f"the root of the cast, {_at(cast.position_mm[0])}, lies {out:.3g} mm outside {where}; the cast is taken from "
        f"{_at(root)} on, where it leads inside, and {left} of {cast.topology.n_terminals} terminals on other vessels "
        "are left out"
    ]
    if not entry.at_wall:
        fork = entry.tree.position_mm[1]
        near = domain.sample(_TRIED, np.random.default_rng(0))
        root = near[np.argmin(((near - fork) ** 2).sum(axis=1))]
        notes.append(
            f"the cast forks at {_at(fork)}, in front of {where}: the root of the grown trees is put at the nearest "
            f"point inside, {_at(root)}, {np.linalg.norm(root - fork):.3g} mm away"
        )
    return root, notes


def _thickening(cast: Tree) -> list[str]:
    """A sentence where the cast is much thicker elsewhere than at its root, as if blood entered there."""
    thickest = int(cast.radius_mm.argmax())
    ratio = float(cast.radius_mm[thickest] / cast.radius_mm[0])
    if ratio < _THICKENING:
        return []
    return [
        f"the cast is {ratio:.1f} times as thick at {_at(cast.position_mm[thickest])} as at its root, "
        f"{_at(cast.position_mm[0])}; if blood enters elsewhere, say so by --root"
    ]


def _at(point: np.ndarray) -> str:
    return f"({', '.join(f'{value:.1f}' for value in point)})"


def root_tree(cast: Tree, generations: int) -> Tree:
    """The first generations of a measured cast, as straight segments."""
    from vascval.core.tree import Topology, Tree

    kept = np.flatnonzero(cast.columns["generation"] <= generations)  # generations only rise along a vessel
    new = np.full(cast.n_nodes, -1)
    new[kept] = np.arange(kept.size)
    parent = np.concatenate(([-1], new[cast.parent[kept[1:]]]))
    return Tree(Topology(parent), cast.position_mm[kept], cast.radius_mm[kept])


def placed(
    configs: Mapping[str, Config],
    changes: Sequence[str],
    ground: Ground,
    start: Start,
    n_terminals: int,
    given: Tree | None,
) -> dict[str, Config]:
    """The configurations with the perfusion volume, the root, or root tree, and so many terminals unless they were
    changed. The root tree is written beside the perfusion volume."""
    from generator.config import DomainConfig
    from vascval.io.trees import write_vtp

    update: dict[str, Any] = {"domain": DomainConfig(file=ground.file)}
    if given is None:
        update["root_mm"] = tuple(start.root_mm.tolist())
    else:
        update["root_tree"] = ground.file.with_name("root-tree.vtp")
        write_vtp(given, update["root_tree"])
    if not any(change.partition("=")[0].strip() == "n_terminals" for change in changes):
        update["n_terminals"] = n_terminals
    return {name: config.model_copy(update=update) for name, config in configs.items()}


def grown(name: str, config: Config, kept: Parts, keeping: Keeping, observer: Observer | None) -> Run:
    """A tree, grown, from where a checkpoint left it; an interruption leaves one."""
    from generator.framework import Run

    run = Run.of(config)
    with sources.about(keeping.path):
        kept.go_on(name, run)
    interrupted = grow(run, keeping, None if observer is None else partial(_told, observer, name))
    if interrupted is not None:
        raise interrupted
    return run


def _told(observer: Observer, name: str, stage: str, done: float, total: float) -> None:
    observer(f"{name}: {stage}", done, total)

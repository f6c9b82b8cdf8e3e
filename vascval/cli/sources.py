"""From file names to analyses: what kind of file an input is, what it is called, and whether outputs can be written."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from vascval.cli.console import Observer, note
from vascval.cli.options import Selection
from vascval.core.errors import InputError, VascvalError

if TYPE_CHECKING:
    from vascval.core.tree import Tree
    from vascval.imaging import Skeleton
    from vascval.morphometry import Analysis

Kind = Literal["volume", "tree", "table"]


@dataclass(frozen=True)
class Measured:
    """An input, measured: its analysis and, where it was a volume, the skeleton with its mask."""

    analysis: Analysis
    skeleton: Skeleton | None = None


@contextmanager
def about(path: Path) -> Iterator[None]:
    """Puts the file's name before the message of an error raised inside, unless it is there already."""
    try:
        yield
    except VascvalError as error:
        if not str(error).startswith(str(path)):
            error.args = (f"{path}: {error}",)
        raise


def kind(path: Path) -> Kind:
    """Whether a file is a volume, a tree or a table, by its name and, where that leaves it open, its content.

    :raises InputError: when it does not exist or is none of these.
    """
    from vascval.io.trees import is_tree_path, is_volume_path

    if not path.exists():
        raise InputError(f"{path}: no such file; check the name")
    if path.suffix.lower() == ".csv":
        return "table"
    if is_tree_path(path):
        return "tree"
    if is_volume_path(path):
        return "volume"
    raise InputError(
        f"{path}: neither a volume nor a tree by its name; volumes are NRRD, NIfTI, MetaImage, TIFF, zarr or HDF5, "
        "trees VTP, VTK, SWC or GXL"
    )


def require(path: Path, wanted: Kind, remedy: str) -> None:
    """Refuses a file of another kind than ``wanted``."""
    found = kind(path)
    if found != wanted:
        raise InputError(f"{path}: is a {found}, and a {wanted} is needed here; {remedy}")


def read_tree(path: Path, unit: str | None) -> Tree:
    """The tree in a file; what had to be guessed is noted on stderr."""
    from vascval.io import trees

    with about(path):
        tree = trees.read_tree(path, unit=unit)
    for guess in tree.meta.get("guesses", ()):
        note(f"{path}: {guess}")
    return tree


def skeletonize(path: Path, selection: Selection, observer: Observer | None) -> Skeleton:
    """The tree of the vessels in a volume."""
    from vascval import imaging
    from vascval.io.scans import open_scan

    with about(path):
        volume = open_scan(
            path,
            spacing_mm=selection.spacing_mm,
            dataset=selection.dataset,
            max_memory_bytes=selection.max_memory_bytes,
        )
        known = list(volume.meta.get("notes", ()))
        for text in known:
            note(f"{path}: {text}")
        skeleton = imaging.skeletonize(
            volume,
            label=selection.label,
            threshold=selection.threshold,
            root_mm=selection.root_mm,
            max_memory_bytes=selection.max_memory_bytes,
            observer=observer,
        )
        for text in skeleton.image["notes"][len(known) :]:
            note(f"{path}: {text}")
        return skeleton


def measure(path: Path, name: str, selection: Selection, unit: str | None, observer: Observer | None) -> Measured:
    """The analysis of a volume or a tree, whichever the file is.

    :raises InputError: also when options that choose from a volume are given for a tree.
    """
    from vascval.morphometry import analyze

    if kind(path) == "volume":
        skeleton = skeletonize(path, selection, observer)
        with about(path):
            return Measured(analyze(skeleton.tree, source=name, image=skeleton.image), skeleton)
    if selection.given():
        raise InputError(f"{path}: is no volume, so {', '.join(selection.given())} cannot apply; leave it out")
    tree = read_tree(path, unit)
    with about(path):
        return Measured(analyze(tree, source=name))


def names(paths: Sequence[Path]) -> list[str]:
    """What each input is called: its file name, with as many of its folders as tell it from the others.

    :raises InputError: when a file is given twice.
    """
    absolute = [path.resolve() for path in paths]
    for k, path in enumerate(absolute):
        if path in absolute[:k]:
            raise InputError(f"{paths[k]}: is given twice; name each tree once")
    result = []
    for path in absolute:
        depth = 1
        while sum(other.parts[-depth:] == path.parts[-depth:] for other in absolute) > 1:
            depth += 1
        result.append("/".join(path.parts[-depth:]))
    return result


def check_file(path: Path, inputs: Sequence[Path] = ()) -> None:
    """Refuses, before the work begins, a file that could not be written at its end or that is an input.

    The file is claimed until the command ends: another run that would write it is refused.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a directory; give the name of a file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is a device or a pipe, which a file would take the place of; give another name")
    check_is_no_input(path, inputs)
    if not path.parent.is_dir():
        raise InputError(f"{path}: the directory {path.parent} does not exist; make it first")
    _check_writable(path, path.parent)
    _claim(path)


def check_is_no_input(path: Path, inputs: Sequence[Path]) -> None:
    """Refuses a file that would overwrite what is read."""
    for source in inputs:
        if path.exists() and source.exists() and path.samefile(source):
            raise InputError(f"{path}: is an input and would be overwritten; write to another file")


def check_json(destination: str | None, inputs: Sequence[Path] = ()) -> None:
    """The same for the value of ``--json``, which may also be left out or ``-``."""
    if destination is not None and destination != "-":
        check_file(Path(destination), inputs)


def check_directory(path: Path, *, adds: bool = False) -> None:
    """Refuses, before the work begins, a directory that could not be written at its end; claims it as a file is.

    A report that is there and will be replaced is noted, unless the command ``adds`` to what there is.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file, not a directory; choose another name with -o")
    if not path.exists() and not path.absolute().parent.is_dir():
        raise InputError(f"{path}: the directory {path.absolute().parent} does not exist; make it first")
    _check_writable(path, path if path.exists() else path.absolute().parent)
    _claim(path)
    if not adds and (path / "report.html").exists():
        note(f"{path}: the report that is there will be replaced at the end; files of other names stay")


def _claim(path: Path) -> None:
    from vascval.io.locks import claimed

    context = click.get_current_context(silent=True)
    if context is not None:
        mine: set[str] = context.meta.setdefault(__name__, set())
        if os.path.abspath(path) in mine:
            raise InputError(f"{path}: is asked for as two outputs; give each a name of its own")
        mine.add(os.path.abspath(path))
        context.with_resource(claimed(path))


def _check_writable(path: Path, directory: Path) -> None:
    if not os.access(directory, os.W_OK | os.X_OK):
        raise InputError(f"{path}: the directory {directory} is not writable; choose another")

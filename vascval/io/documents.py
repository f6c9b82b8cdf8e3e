"""The JSON documents that commands write, as models, and the published tables that a comparison reads.

Rows of tables are described in :mod:`vascval.io.rows`. A number that does not exist is ``null``; one that is not
finite never appears.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vascval.core.errors import InputError
from vascval.io.rows import (
    ConnectivityRow,
    DistributionRow,
    GenerationRow,
    HortonRow,
    LocationRow,
    Number,
    OrderRow,
    OrganRow,
    ReferenceRow,
    SensitivityRow,
    TerritoryRow,
    TotalRow,
)


def _f(meaning: str, **options: Any) -> Any:
    return Field(description=meaning, **options)


class Document(BaseModel):
    """A JSON document; what is named is fixed, anything may be added."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class Summary(Document):
    """Totals of one tree."""

    n_terminals: int = _f("segments that end without children")
    n_segments: int = _f("segments")
    n_bifurcations: int = _f("nodes with exactly two children")
    n_trifurcations: int = _f("nodes with exactly three children")
    n_trifurcations_first_7: int = _f("those fed by generations up to 7")
    n_multifurcations: int = _f("nodes with four children or more")
    n_monopodial: int = _f("monopodial branches by the thresholds under parameters")
    n_elements: int = _f("elements")
    total_length_mm: float = _f("summed length")
    volume_mm3: float = _f("summed pi r^2 l")
    max_order: int = _f("Strahler order of the root segment")
    max_diameter_order: int | None = _f("largest diameter-defined order; null when the iteration did not converge")
    n_overlaps: int = _f("pairs of segments without a common node whose capsules intersect, after contraction")
    n_overlaps_as_given: int = _f("the same before contraction of degenerate segments")
    n_contracted: int = _f("degenerate segments contracted before measuring")
    murray_exponent_median: Number = _f("median over the nodes that have one")
    branching_angle_mean_deg: Number = _f("mean angle of a child to the segment that feeds it")
    tortuosity_mean: Number = _f("mean of path over chord")
    length_to_diameter_mean: Number = _f("mean of length over diameter")


class Coverage(Document):
    """How terminals fill the tissue."""

    domain: Literal["given points", "convex hull of the terminals"] = _f("what stands for the tissue")
    n_points: int = _f("points of the tissue")
    volume_mm3: Number = _f("volume of the tissue; null when only points were given")
    terminals_per_mm3: Number = _f("terminals over that volume")
    distance_mean_mm: float = _f("mean distance of a tissue point to the nearest terminal")
    distance_sd_mm: float = _f("its standard deviation")
    distance_median_mm: float = _f("its median")
    distance_q95_mm: float = _f("its 95 % quantile")
    distance_max_mm: float = _f("its maximum")
    evenness: Number = _f("mean distance over that of as many random terminals in infinite tissue, 0.554 (V / n)^(1/3)")


class Image(Document):
    """What skeletonisation did to the image."""

    n_components: int = _f("connected components of the mask")
    largest_component_fraction: float = _f("share of the voxels in the component kept")
    n_spurs_pruned: int = _f("spurs pruned")
    n_loops_cut: int = _f("loops cut")
    voxel_mm: list[float] = _f("voxel size, x y z")


class AnalyzeDocument(Document):
    """Output of ``vascval analyze --json``, and of each tree under ``compare``."""

    source: str = _f("file or description that the tree comes from")
    summary: Summary
    generations: list[GenerationRow]
    orders: list[OrderRow] = _f("per order, for each ordering that converged")
    horton: list[HortonRow]
    organs: list[OrganRow] = _f("Horton ratios of real organs beside the tree's: what is plausible, no pass mark")
    connectivity: list[ConnectivityRow]
    monopodial_sensitivity: list[SensitivityRow]
    coverage: Coverage | None = _f("null when the terminals span no volume")
    parameters: dict[str, Any] = _f("thresholds and rules used")
    notes: list[str] = _f("what was found, repaired or left out")
    image: Image | None = _f("only for a tree that comes from a volume", default=None)


class ReferenceDocument(Document):
    """A published per-generation table as it was read."""

    source: str = _f("file name")
    citation: str = _f("comment lines of the file: where the values come from")
    generations: list[ReferenceRow]


class Differences(Document):
    """Tree minus cast by generation: each measure of the generations and, beside it, ``<measure>_relative``."""

    tree: str = _f("source of the tree")
    against: str = _f("source of what was subtracted")
    generations: list[dict[str, Number]] = _f("rows as under generations; null where a side has no such value")


class LocationDocument(Document):
    """Where the vessels lie, both ways."""

    tree: str = _f("source of the tree")
    tolerance_mm: float = _f("matched: within this distance, or within the local radius where that is more")
    step_mm: float = _f("largest distance between the points compared along a centreline")
    generation_window: int = _f("generations that differ by at most this are like")
    matched_threshold: float = _f("share from which on a generation counts as matched")
    matched_down_to_generation: int = _f("last generation up to which every one of the cast is matched; 0 for none")
    generations: list[LocationRow]


class TerritoryDocument(Document):
    """Overlap of perfusion territories."""

    tree: str = _f("source of the tree")
    n_points: int = _f("points of a grid in the common hull of both trees' terminals")
    generations: list[TerritoryRow]


class CompareDocument(Document):
    """Output of ``vascval compare --json`` and of ``vascval demo``."""

    cast: AnalyzeDocument | ReferenceDocument
    trees: list[AnalyzeDocument]
    reference: ReferenceDocument | None = _f("a published table beside the cast", default=None)
    totals: list[TotalRow]
    differences: list[Differences] = _f("tree minus cast, one per tree")
    reference_differences: list[Differences] = _f("cast and trees minus reference")
    distributions: list[DistributionRow]
    location: list[LocationDocument] = _f("one per tree; empty when a published table stands in for the cast")
    territories: list[TerritoryDocument | None] = _f("one per tree; null where the trees have no tissue in common")
    parameters: dict[str, Any] = _f("rules used")
    notes: list[str]


class SkeletonizeDocument(Document):
    """Output of ``vascval skeletonize --json``."""

    source: str = _f("the volume")
    n_terminals: int = _f("segments that end without children")
    n_segments: int = _f("segments")
    image: Image


class Stage(Document):
    """One stage of growing a tree."""

    name: Literal["growth", "topology", "geometry"]
    seconds: float = _f("wall time")
    volume_mm3: float = _f("volume of the tree after the stage")
    tests: int | None = _f("topology changes tested", default=None)
    solves: int | None = _f("geometry problems solved", default=None)


class GenerateDocument(Document):
    """Output of ``vascval generate --json``."""

    volume_mm3: float
    n_terminals: int
    n_segments: int
    n_trifurcations: int
    seed: int | None
    peak_memory_mb: float
    stages: list[Stage]


class Searched(Document):
    """What the search of ``vascval generate`` reaches on the same terminals."""

    volume_mm3: float = _f("volume of the best tree that it found")
    tests: int = _f("topologies tried, of all chains")
    seconds: float = _f("wall time")


class OptimumDocument(Document):
    """Output of ``vascval optimum --json``."""

    volume_mm3: float = _f("volume of the best tree over all topologies")
    enumerated_mm3: float = _f("the same of the enumeration alone; more where the search has a better geometry")
    n_terminals: int = _f("terminals, 2 to 10")
    shortest_mm: float = _f("length of the shortest segment")
    seed: int = _f("with which the terminals were drawn, if they were")
    n_topologies: int = _f("topologies that there are, (2 n - 3)!! for n terminals")
    n_bounded: int = _f("partial trees for which a bound was found")
    n_optimised: int = _f("whole topologies that no bound ruled out, and whose geometry was optimised")
    seconds: float = _f("wall time of finding the optimum")
    search: Searched
    ratio: float = _f("volume of the search over the optimum")
    certificate: str = _f("what is proven and what is not")


def plain(value: Any) -> Any:
    """``value`` as JSON knows it: NumPy and pandas scalars unwrapped, frames as records, not finite as ``None``."""
    if isinstance(value, pd.DataFrame):
        columns = {str(name): plain(series.tolist()) for name, series in value.items()}
        return [dict(zip(columns, row)) for row in zip(*columns.values())]
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if value is pd.NA or value is None:
        return None
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@dataclass(frozen=True, eq=False)
class ReferenceTable:
    """A published per-generation table: ``source`` (file name), ``citation`` (its comment lines, carried and shown)
    and ``generations``, one row per generation ascending, with the columns that were given."""

    source: str
    citation: str
    generations: pd.DataFrame

    def document(self) -> dict[str, Any]:
        """The JSON form, checked against :class:`ReferenceDocument`."""
        document: dict[str, Any] = plain(
            {"source": self.source, "citation": self.citation, "generations": self.generations}
        )
        ReferenceDocument.model_validate(document)
        return document


def read_reference_table(path: str | Path) -> ReferenceTable:
    """Read a published per-generation table from a CSV file in UTF-8.

    The first line that is no comment holds the columns, of which only ``generation`` is obligatory
    (:class:`vascval.io.rows.ReferenceRow` lists them; lengths are in mm). Lines that begin with ``#`` state the source
    of the values. Empty cells are unknown values.

    :raises InputError: on a file that cannot be read, unknown, repeated or missing columns, cells that are no
        numbers or out of range, ragged lines, and generations that are repeated or not whole numbers from 1 on.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give an existing CSV file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text in UTF-8; save the table as CSV in UTF-8") from None
    citation = "\n".join(line.lstrip("# ").rstrip(" ,") for line in lines if line.startswith("#"))
    numbered = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not numbered:
        raise InputError(f"{path}: has no table; a line with the column names and one line per generation are needed")
    cells = list(csv.reader(line for _, line in numbered))
    header = [name.strip() for name in cells[0]]
    _check_header(path, header)
    rows = []
    for (number, _), cell in zip(numbered[1:], cells[1:]):
        if len(cell) != len(header):
            raise InputError(f"{path}: line {number} has {len(cell)} cells for {len(header)} columns; mend the line")
        values = {name: text.strip() or None for name, text in zip(header, cell)}
        try:
            rows.append(ReferenceRow.model_validate(values).model_dump(include=set(header)))
        except ValidationError as error:
            first = error.errors()[0]
            where = f"line {number}, column {first['loc'][0]!r}"
            raise InputError(f"{path}: {where}: {first['input']!r}: {first['msg']}; mend the cell") from None
    repeated = [value for value, count in Counter(row["generation"] for row in rows).items() if count > 1]
    if repeated or not rows:
        what = f"generation {repeated[0]} comes more than once" if repeated else "there is no generation"
        raise InputError(f"{path}: {what}; one line per generation is needed")
    frame = pd.DataFrame(rows)[header].sort_values("generation", ignore_index=True)
    return ReferenceTable(path.name, citation, frame.astype({name: float for name in header if name != "generation"}))


def _check_header(path: Path, header: list[str]) -> None:
    known = list(ReferenceRow.model_fields)
    unknown = [name for name in header if name not in known]
    repeated = [name for name, count in Counter(header).items() if count > 1]
    if unknown:
        raise InputError(f"{path}: unknown column {unknown[0]!r}; the columns are {', '.join(known)}")
    if repeated:
        raise InputError(f"{path}: column {repeated[0]!r} comes more than once; name each column once")
    if "generation" not in header:
        raise InputError(f"{path}: there is no column 'generation'; add it, the root's generation being 1")

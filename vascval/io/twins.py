"""The JSON document of ``vascval twin``: a comparison, and what its trees were grown from."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from vascval.io.documents import CompareDocument, Document, Stage


def _f(meaning: str, **options: Any) -> Any:
    return Field(description=meaning, **options)


class TwinDomain(Document):
    """The perfusion volume."""

    kind: Literal["hull", "volume", "surface"] = _f("hull of the cast, or what was given")
    source: str = _f("name of the file given, or the cast's")
    file: str = _f("name of the file written, as which it can be given again")
    volume_mm3: float = _f("its volume")
    closing_mm: float = _f("radius of the balls with which cast or volume was closed; 0 for none")
    margin_mm: float = _f("how far a hull goes beyond the closing")


class TwinRoot(Document):
    """Where the grown trees begin."""

    position_mm: tuple[float, float, float] = _f("the root, inside the perfusion volume")
    cast_position_mm: tuple[float, float, float] = _f("where the cast that is compared begins")
    given_position_mm: tuple[float, float, float] = _f("where the whole cast begins")
    moved_mm: float = _f("how far the root lies from the cast, which ends in front of the perfusion volume; else 0")
    radius_mm: float = _f("of the cast's first segment")
    generations_given: int = _f("generations of the cast that the grown trees are given; 0 for none")
    n_segments_given: int = _f("their segments")


class TwinCast(Document):
    """How much of the cast is inside; shares of the cast that is compared."""

    n_terminals_given: int = _f("terminals of the whole cast")
    n_terminals_left_out: int = _f("those that are not compared, on vessels that do not lead into the perfusion volume")
    length_inside_share_given: float = _f("share of the whole cast's length")
    length_inside_share: float = _f("share of the length")
    volume_inside_share: float = _f("share of the vessels' volume")
    terminals_inside_share: float = _f("share of the terminals")


class TwinPerfusion(Document):
    """What drives the flow."""

    preset: str
    root_pressure_mmhg: float
    terminal_pressure_mmhg: float
    flow_ml_min: float
    viscosity_cp: float
    gamma: float = _f("branching exponent")


class TwinTree(Document):
    """A grown tree."""

    source: str
    file: str
    method: Literal["cco", "full"]
    n_terminals: int
    volume_mm3: float
    root_radius_mm: float
    root_radius_to_cast: float = _f("that over the cast's")
    pressure_drop_at_cast_root_mmhg: float = _f("pressure drop at which the root would be as thick as the cast's")
    stages: list[Stage] | None = _f("how it was grown; not in report.json, which holds no times", default=None)


class Twin(Document):
    """What the trees were grown from."""

    domain: TwinDomain
    root: TwinRoot
    cast: TwinCast
    perfusion: TwinPerfusion
    seed: int
    trees: list[TwinTree]
    notes: list[str]


class TwinDocument(CompareDocument):
    """Output of ``vascval twin --json``."""

    twin: Twin

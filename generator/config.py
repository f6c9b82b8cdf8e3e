"""The configuration of a run: one validated model, read from a preset or a TOML file, changed by ``key=value``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from generator.geometry.problem import Physics
from generator.growth.growth import GrowthOptions
from generator.haemodynamics import Perfusion
from generator.topology.annealing import AnnealingOptions
from vascval.core.errors import InputError
from vascval.core.units import MM3_S_PER_ML_MIN, PA_PER_MMHG, PA_S_PER_CP

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_PRESETS = Path(__file__).with_name("presets")
Point = tuple[float, float, float]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class DomainConfig(_Model):
    """Where the tree grows: a box, a file (label volume or closed surface) or a bundled shape."""

    box_mm: Point | None = Field(
        default=None, description="sides of an axis-parallel box with one corner at the origin"
    )
    file: Path | None = Field(
        default=None, description="label volume (NRRD, NIfTI) or closed surface (STL, OBJ, VTK, VTP)"
    )
    shape: Literal["liver", "horseshoe", "ball"] | None = Field(default=None, description="a bundled analytic shape")
    label: int | None = Field(default=None, description="label of the volume that is the domain; default: all but 0")
    closing_mm: float = Field(
        default=0.0, ge=0.0, description="close gaps in a label volume that are narrower than twice this"
    )
    keep: Literal["all", "largest"] = Field(
        default="all", description="of a domain in several pieces: refuse, or the largest"
    )

    @model_validator(mode="after")
    def _one_kind(self) -> DomainConfig:
        given = [name for name in ("box_mm", "file", "shape") if getattr(self, name) is not None]
        if len(given) != 1:
            have = " and ".join(given) or "none of them"
            raise ValueError(f"one of box_mm, file and shape is needed, not {have}")
        return self


class PerfusionConfig(_Model):
    """What drives the flow."""

    root_pressure_mmhg: float = Field(description="pressure at the root")
    terminal_pressure_mmhg: float = Field(description="pressure at every terminal")
    flow_ml_min: float = Field(gt=0.0, description="flow through the root")
    viscosity_cp: float = Field(default=3.6, gt=0.0, description="viscosity of blood")


class GrowthConfig(_Model):
    """Rules of growth, see :class:`generator.growth.growth.GrowthOptions`."""

    spacing: float = Field(
        default=0.4, ge=0.0, description="distance of a new terminal from the tree, in mean spacings"
    )
    diameters: float = Field(default=1.0, ge=0.0, description="shortest length of a new segment, in its diameters")
    l_min_mm: float = Field(default=0.0, ge=0.0, description="shortest length of a new segment")
    merge_mm: float | None = Field(
        default=None, ge=0.0, description="bifurcations nearer to the proximal node go there"
    )
    r_min_mm: float = Field(default=0.0, ge=0.0, description="smallest radius of a new terminal")
    at_r_min: Literal["stop", "error"] = Field(default="error", description="what happens when it is reached")
    avoid_intersections: bool = Field(default=False, description="vessels that share no node do not overlap")


class GeometryConfig(_Model):
    """How the geometry is optimised, see :mod:`generator.geometry`."""

    solver: Literal["reduced", "ipopt"] = Field(default="reduced", description="reduced space, or full space by Ipopt")
    during_growth: bool = Field(default=True, description="while growing too, if vessels may overlap")
    every: int = Field(default=20, ge=1, description="terminals between two optimisations, up to 1,000 terminals")
    every_at_most: int = Field(default=500, ge=1, description="and beyond, where it grows in proportion to them")
    contract: bool = Field(default=True, description="contract segments shorter than their diameter in the end")
    split: bool = Field(default=True, description="split junctions again where that lowers the volume")
    l_min_mm: float = Field(default=0.2, ge=0.0, description="shortest length of a segment")
    r_min_mm: float = Field(default=0.0, ge=0.0, description="smallest radius of a segment")
    objective: Literal["volume", "volume+power"] = Field(
        default="volume", description="power that moves the blood counts too, and the root pressure is free"
    )
    metabolic_w_m3: float = Field(default=648.0, gt=0.0, description="power that a volume of blood costs to keep")
    gamma_by_generation: tuple[float, ...] = Field(default=(), description="instead of gamma, from generation 1 on")

    def interval(self, n_terminals: int) -> int:
        """Terminals between two optimisations of a tree of that size."""
        return max(1, min(self.every_at_most, self.every * max(1000, n_terminals) // 1000))


class TopologyConfig(_Model):
    """How topologies are searched, see :class:`generator.topology.annealing.AnnealingOptions`."""

    at: int = Field(default=500, ge=1, description="terminals at which growth pauses for it")
    tests: int = Field(default=300_000, ge=1, description="topologies tried by each chain")
    chains: int = Field(default=2, ge=1, description="independent searches, of which the best counts")
    rounds: int = Field(
        default=1,
        ge=1,
        description="times that all chains search; the best half of the trees goes on from the first, the best half of "
        "these from the next, down to one, each with subtrees of the others where those are better",
    )
    heat: float = Field(default=0.5, gt=0.0, description="start temperature, in median rises of the cost by a move")
    cooling: float = Field(default=120.0, ge=1.0, description="start over end temperature")
    lenience: float = Field(
        default=0.7, ge=0.0, le=1.0, description="power of the terminals moved by which a move's temperature is higher"
    )
    swaps: float = Field(default=0.2, ge=0.0, le=1.0, description="share of swaps among the moves")

    def options(self) -> AnnealingOptions:
        """What the search takes."""
        return AnnealingOptions(self.tests, self.heat, self.cooling, self.lenience, self.swaps, self.chains)


class Config(_Model):
    """Everything that decides a tree."""

    method: Literal["cco", "geometry", "full"] = Field(
        default="cco", description="growth, with geometry, with topology"
    )
    seed: int = Field(default=1, ge=0, description="of the random numbers: same seed, same tree")
    n_terminals: int = Field(ge=1, le=10**9, description="terminals to grow; ignored with terminals_file")
    n_connections: int = Field(default=32, ge=1, description="nearest segments tried for each new terminal")
    gamma: float = Field(ge=2.0, le=3.0, description="branching exponent of Murray's law")
    viscosity: Literal["constant", "fahraeus-lindqvist"] = Field(
        default="constant", description="how it depends on radius"
    )
    root_mm: Point | None = Field(default=None, description="where blood enters; bundled shapes have their own")
    root_tree: Path | None = Field(
        default=None, description="tree whose segments and radii are given; its ends grow on"
    )
    terminals_file: Path | None = Field(default=None, description="CSV with x_mm, y_mm, z_mm; first row: the root")
    terminals_order: Literal["spread", "given", "random"] = Field(
        default="spread", description="in which they are inserted"
    )
    domain: DomainConfig
    perfusion: PerfusionConfig
    growth: GrowthConfig = GrowthConfig()
    geometry: GeometryConfig = GeometryConfig()
    topology: TopologyConfig = TopologyConfig()

    @model_validator(mode="after")
    def _available(self) -> Config:
        if self.method == "full" and self.growth.avoid_intersections:
            raise ValueError("method=full lets vessels overlap; use method=geometry where they must not")
        if self.viscosity != "constant" and self.method == "cco":
            raise ValueError(f"growth alone knows constant viscosity; viscosity={self.viscosity} needs method=geometry")
        if self.root_tree is not None and self.root_mm is not None:
            raise ValueError("root_mm and root_tree exclude each other; give one")
        return self

    def flow(self) -> Perfusion:
        """The perfusion in g, mm and s."""
        given = self.perfusion
        return Perfusion(
            given.root_pressure_mmhg * PA_PER_MMHG,
            given.terminal_pressure_mmhg * PA_PER_MMHG,
            given.flow_ml_min * MM3_S_PER_ML_MIN,
            given.viscosity_cp * PA_S_PER_CP,
            self.gamma,
        )

    def physics(self) -> Physics:
        """What decides the geometry, as its solvers take it."""
        given = self.geometry
        return Physics(
            viscosity=self.viscosity,
            gamma_by_generation=given.gamma_by_generation,
            objective=given.objective,
            metabolic_pa_s=given.metabolic_w_m3,
            l_min_mm=given.l_min_mm,
            r_min_mm=given.r_min_mm,
        )

    def growth_options(self) -> GrowthOptions:
        """The rules of growth as growth takes them."""
        given = self.growth
        return GrowthOptions(
            n_connections=self.n_connections,
            spacing=given.spacing,
            diameters=given.diameters,
            shortest_mm=given.l_min_mm,
            merge_mm=given.merge_mm,
            thinnest_mm=given.r_min_mm,
            at_thinnest=given.at_r_min,
            apart=1.0 if given.avoid_intersections else 0.0,
        )


def presets() -> list[str]:
    """The names of the bundled configurations."""
    return sorted(path.stem for path in _PRESETS.glob("*.toml"))


def load(name: str, changes: Sequence[str] = ()) -> Config:
    """A preset, or a TOML file, with ``key=value`` changes; keys of tables are written ``table.key``.

    File names inside a TOML file are relative to that file, those in ``changes`` to the working directory.

    :raises InputError: when it cannot be read, a key is unknown or a value makes no sense.
    """
    preset = name in presets()
    path = _PRESETS / f"{name}.toml" if preset else Path(name)
    if not preset and not path.exists():
        raise InputError(f"{name}: neither a file nor a preset; the presets are {', '.join(presets())}")
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{name}: cannot be read ({error}); give a TOML file or a preset") from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, whole numbers of thousands of digits, nesting
        raise InputError(f"{name}: is no valid TOML ({error}); mend it") from error
    for table, key in ((data, "root_tree"), (data, "terminals_file"), (data.get("domain"), "file")):
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = str(path.parent / table[key])
    for change in changes:
        _apply(data, change)
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{name}: {_sentence(error)}") from error


def _apply(data: dict[str, Any], change: str) -> None:
    key, equals, text = change.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise InputError(f"--set {change}: is not key=value; write for example --set n_terminals=500")
    table = data
    for part in parts[:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise InputError(f"--set {change}: {part} is a value, not a table; see the keys by vascval schema")
    if parts[0] == "domain" and parts[-1] in ("box_mm", "file", "shape"):
        for other in ("box_mm", "file", "shape"):
            table.pop(other, None)
    if parts == ["root_tree"]:
        data.pop("root_mm", None)
    table[parts[-1]] = _value(text.strip())


def _value(text: str) -> Any:
    """A number, a truth value, a list of numbers joined by commas, ``none``, or else the text."""
    words: dict[str, Any] = {"true": True, "false": False, "none": None}
    if text.lower() in words:
        return words[text.lower()]
    parts = text.split(",")
    try:
        numbers = [_number(part) for part in parts]
    except ValueError:
        return text
    return numbers if len(parts) > 1 else numbers[0]


def _number(text: str) -> int | float:
    try:
        return int(text)
    except ValueError:
        return float(text)


def _sentence(error: ValidationError) -> str:
    """The first thing that is wrong, in one line."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    what = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        model: Any = Config
        for part in first["loc"][:-1]:
            model = model.model_fields[str(part)].annotation
        return f"{where} is no key of the configuration; the keys are {', '.join(model.model_fields)}"
    if first["type"] == "missing":
        return f"{where} is missing; add it or begin with a preset ({', '.join(presets())})"
    more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{where + ': ' if where else ''}{what[0].lower()}{what[1:]}{more}; correct it"

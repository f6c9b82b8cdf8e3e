"""The registry of named columns: one place for the name, type, place, unit and meaning of what a tree carries.

Everything that names a column takes it from here: the arrays of a VTP file, the headers of a CSV table, the JSON
schemas and the documentation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vascval.core.errors import InputError


@dataclass(frozen=True)
class Column:
    """A named column of a tree.

    ``place`` is ``"node"`` (a value at each point) or ``"segment"`` (a value for the segment that ends at each node;
    the entry of the root node, which no segment feeds, is a placeholder).
    """

    name: str
    dtype: str
    place: Literal["node", "segment"]
    unit: str
    meaning: str


_COLUMNS = (
    Column("radius_mm", "float64", "segment", "mm", "radius of the vessel"),
    Column("length_mm", "float64", "segment", "mm", "length along the centreline"),
    Column("flow_mm3_s", "float64", "segment", "mm^3/s", "volumetric blood flow"),
    Column("pressure_drop_pa", "float64", "segment", "Pa", "pressure drop from the proximal to the distal end"),
    Column("pressure_pa", "float64", "node", "Pa", "pressure"),
    Column("order", "int32", "segment", "1", "Strahler order, terminals 1"),
    Column("diameter_order", "int32", "segment", "1", "diameter-defined Strahler order (Jiang 1994)"),
    Column("generation", "int32", "segment", "1", "generation, root 1: order of the root segment - order + 1"),
    Column("parent", "int32", "segment", "1", "cell index of the segment that feeds this one, -1 at the root"),
    Column("element", "int32", "segment", "1", "index of the element (run of segments of equal order in series)"),
    Column("radius_sd_mm", "float64", "segment", "mm", "standard deviation of the radius along the segment"),
)

COLUMNS: dict[str, Column] = {column.name: column for column in _COLUMNS}


def column(name: str) -> Column:
    """The registered column of that name.

    :raises InputError: when there is none.
    """
    try:
        return COLUMNS[name]
    except KeyError:
        raise InputError(f"no column is named {name!r}; the columns are {', '.join(COLUMNS)}") from None


def as_column(name: str, values: object, n_nodes: int) -> np.ndarray:
    """``values`` as a read-only array of the registered type and of shape ``(n_nodes,)``.

    :raises InputError: when the name is not registered or the shape is wrong.
    """
    spec = column(name)
    array = np.array(values, dtype=spec.dtype)
    if array.shape != (n_nodes,):
        raise InputError(f"column {name!r} has shape {array.shape}; one value for each of {n_nodes} nodes is needed")
    array.setflags(write=False)
    return array

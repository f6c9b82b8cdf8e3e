"""JSON Schemas of everything that is read or written here, generated from the models; see ``data_schemas/``.

``vascval schema --write DIRECTORY`` writes them all, and that of the generator's configuration.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, TypeAdapter

from vascval.core.columns import COLUMNS
from vascval.core.errors import InputError
from vascval.io import documents, ensembles, twins
from vascval.io.rows import TABLES

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_DOCUMENTS: dict[str, type[BaseModel]] = {
    "analyze": documents.AnalyzeDocument,
    "compare": documents.CompareDocument,
    "demo": documents.CompareDocument,
    "ensemble": ensembles.EnsembleDocument,
    "ensemble-manifest": ensembles.ManifestDocument,
    "generate": documents.GenerateDocument,
    "optimum": documents.OptimumDocument,
    "skeletonize": documents.SkeletonizeDocument,
    "twin": twins.TwinDocument,
}


def names() -> list[str]:
    """The names of all schemas: JSON documents, ``table-*`` (CSV files as arrays of rows) and ``tree-arrays`` (VTP)."""
    return [*_DOCUMENTS, *(f"table-{name}" for name in TABLES), "tree-arrays"]


def schema(name: str) -> dict[str, Any]:
    """The JSON Schema (2020-12) of that name.

    :raises InputError: when there is none.
    """
    if name in _DOCUMENTS:
        return {"$schema": _DIALECT, "$id": name, **_DOCUMENTS[name].model_json_schema()}
    if name == "tree-arrays":
        return {"$schema": _DIALECT, "$id": name, **_tree_arrays()}
    table = TABLES.get(name.removeprefix("table-"))
    if table is None or not name.startswith("table-"):
        raise InputError(f"no schema is named {name!r}; the schemas are {', '.join(names())}")
    adapter: TypeAdapter[Any] = TypeAdapter(list[table])  # type: ignore[valid-type]
    return {"$schema": _DIALECT, "$id": name, "title": f"Table {name[6:]}", **adapter.json_schema()}


def _tree_arrays() -> dict[str, Any]:
    """The arrays of a VTP tree: cell arrays have one value per segment, point arrays one per point."""
    kinds = {"float64": "number", "int32": "integer"}
    places: dict[str, dict[str, Any]] = {"segment": {}, "node": {}}
    for column in COLUMNS.values():
        places[column.place][column.name] = {
            "type": "array",
            "items": {"type": kinds[column.dtype]},
            "description": f"{column.meaning} [{column.unit}]",
        }
    return {
        "title": "Tree arrays",
        "description": "Arrays of a tree in VTP PolyData: one line cell per segment, root first.",
        "type": "object",
        "properties": {
            "cell_data": {
                "type": "object",
                "properties": places["segment"],
                "required": ["radius_mm"],
                "additionalProperties": True,
            },
            "point_data": {"type": "object", "properties": places["node"], "additionalProperties": True},
        },
        "required": ["cell_data"],
        "additionalProperties": True,
    }

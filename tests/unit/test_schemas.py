"""Schemas on disk are those of the code; tables and documents are what the schemas say; published tables are read."""

import json
import math

import jsonschema
import numpy as np
import pandas as pd
import pytest

from vascval.comparison import compare
from vascval.core.columns import COLUMNS
from vascval.core.errors import InputError
from vascval.core.tree import Topology, Tree
from vascval.io import schemas
from vascval.io.documents import plain, read_reference_table
from vascval.io.rows import TABLES
from vascval.morphometry import analyze
from vascval.report.ensemble_tables import Member, gather

CLI_KEYS = {
    "summary": "n_terminals n_segments n_bifurcations n_trifurcations n_trifurcations_first_7 n_monopodial "
    "total_length_mm volume_mm3 max_order n_overlaps",
    "generations": "generation order n_segments n_elements radius_mean_mm radius_sd_mm length_mean_mm length_sd_mm "
    "branching_ratio_mean",
}


def small_tree(lift=0.0):
    position = [[0, 0, 0], [20, 0, 0], [40, 10, lift], [40, -10, 0]]
    position += [[60, 15, 5], [70, 5, -5], [60, -5, 5], [75, -15, 9]]
    parent = np.array([-1, 0, 1, 1, 2, 2, 3, 3])
    return Tree(Topology(parent), np.array(position, float), np.array([0, 2, 1.5, 1.4, 1, 0.9, 1, 0.8]))


@pytest.fixture(scope="module")
def comparison(tmp_path_factory):
    path = tmp_path_factory.mktemp("reference") / "published.csv"
    path.write_text("# Somebody 1999, table 2\ngeneration,n_segments,radius_mean_mm\n1,1,2.1\n2,2,\n")
    image = {"n_components": 2, "largest_component_fraction": 0.99, "n_spurs_pruned": 1, "n_loops_cut": 0,
             "voxel_mm": [0.5, 0.5, 1.0]}  # fmt: skip
    cast = analyze(small_tree(), source="cast", image=image)
    return compare(cast, [analyze(small_tree(3.0), source="tree")], reference=read_reference_table(path))


@pytest.mark.parametrize("name", schemas.names())
def test_schemas_are_sound_and_every_value_is_explained(name):
    schema = schemas.schema(name)
    jsonschema.Draft202012Validator.check_schema(schema)
    if name.startswith("table-"):
        for column, spec in schema["items"].get("properties", {}).items() or _row_properties(schema):
            assert spec.get("description"), column


def _row_properties(schema):
    return schema["$defs"][schema["items"]["$ref"].rsplit("/", 1)[1]]["properties"].items()


def test_an_unknown_schema_is_refused():
    with pytest.raises(InputError, match="no schema is named 'nonsense'; the schemas are analyze, compare"):
        schemas.schema("nonsense")
    with pytest.raises(InputError, match="no schema is named 'generations'"):
        schemas.schema("generations")


def test_tree_arrays_are_the_registered_columns():
    properties = schemas.schema("tree-arrays")["properties"]
    named = {**properties["cell_data"]["properties"], **properties["point_data"]["properties"]}
    assert set(named) == set(COLUMNS)
    assert properties["point_data"]["properties"].keys() == {"pressure_pa"}
    assert named["order"]["items"] == {"type": "integer"}


def test_tables_have_the_columns_of_their_rows(comparison):
    analysis, location = comparison.cast, comparison.location[0]
    both = [Member(name, "", 1, "0", side.document()) for name, side in zip("ab", (analysis, comparison.trees[0]))]
    ensemble = gather(both, n_asked=2)
    tables = {
        "generations": analysis.generations,
        "orders": analysis.orders,
        "segments": analysis.segments,
        "elements": analysis.elements,
        "junctions": analysis.junctions,
        "horton": analysis.horton,
        "organs": analysis.organs,
        "connectivity": analysis.connectivity,
        "monopodial-sensitivity": analysis.monopodial_sensitivity,
        "totals": comparison.totals,
        "distributions": comparison.distributions,
        "location": location.generations,
        "segment-location": location.cast_segments,
        "territories": comparison.territories[0].generations,
        "reference": None,
        "ensemble-trees": ensemble.trees,
        "ensemble-spread": pd.concat([ensemble.totals, ensemble.generations]),
        "search-history": None,
    }
    assert set(tables) == set(TABLES)
    for name, table in tables.items():
        if table is not None:
            assert len(table)
            assert set(table.columns) == set(TABLES[name].model_fields), name
            jsonschema.validate(plain(table), schemas.schema(f"table-{name}"))


def test_documents_are_valid_and_strict_json(comparison):
    for name, document in (("analyze", comparison.cast.document()), ("compare", comparison.document())):
        text = json.dumps(document, allow_nan=False)
        jsonschema.validate(json.loads(text), schemas.schema(name))
    assert schemas.schema("demo")["properties"] == schemas.schema("compare")["properties"]


def test_documents_have_the_keys_of_the_contract(comparison):
    document = comparison.document()
    cast = document["cast"]
    for side in (cast, *document["trees"]):
        assert set(CLI_KEYS["summary"].split()) <= set(side["summary"])
        assert all(set(CLI_KEYS["generations"].split()) <= set(row) for row in side["generations"])
    assert set(cast["image"]) == {
        "n_components", "largest_component_fraction", "n_spurs_pruned", "n_loops_cut", "voxel_mm"
    }  # fmt: skip
    assert "image" not in document["trees"][0]
    assert {"differences", "distributions", "location", "trees"} <= set(document)
    assert document["reference"]["citation"] == "Somebody 1999, table 2"
    assert document["reference"]["generations"][1] == {"generation": 2, "n_segments": 2.0, "radius_mean_mm": None}


def test_plain_has_no_number_that_is_not_finite():
    frame = pd.DataFrame({"a": [1.0, math.nan], "b": pd.array([1, None], "Int64"), "c": [True, False]})
    assert plain(frame) == [{"a": 1.0, "b": 1, "c": True}, {"a": None, "b": None, "c": False}]
    given = {1: np.array([math.inf, 2.0]), "x": (np.int32(3), np.bool_(True)), "y": pd.NA, "z": "text"}
    assert plain(given) == {"1": [None, 2.0], "x": [3, True], "y": None, "z": "text"}
    assert type(plain(given)["x"][0]) is int


def test_schema_refuses_what_is_not_a_number(comparison):
    document = comparison.cast.document()
    document["summary"]["n_overlaps"] = None
    with pytest.raises(jsonschema.ValidationError, match="None is not of type 'integer'"):
        jsonschema.validate(document, schemas.schema("analyze"))


def write(tmp_path, text):
    path = tmp_path / "published.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_published_table_is_read_with_its_source(tmp_path):
    text = '\ufeff# Debbaut 20xx,,\n# "table 1"\n\n radius_mean_mm , generation\n\n0.5,2\n,1\n'
    table = read_reference_table(write(tmp_path, text))
    assert table.source == "published.csv"
    assert table.citation == 'Debbaut 20xx\n"table 1"'
    assert table.generations["generation"].tolist() == [1, 2]
    assert table.generations["radius_mean_mm"].tolist() == pytest.approx([math.nan, 0.5], nan_ok=True)
    jsonschema.validate(plain(table.generations), schemas.schema("table-reference"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no table; a line with the column names and one line per generation are needed"),
        ("# only a source\n", "has no table"),
        ("generation,radius_um\n1,2\n", "unknown column 'radius_um'; the columns are generation, n_segments"),
        ("generation,n_segments,n_segments\n1,2,3\n", "column 'n_segments' comes more than once"),
        ("n_segments\n1\n", "there is no column 'generation'; add it, the root's generation being 1"),
        ("generation\n", "there is no generation; one line per generation is needed"),
        ("generation\n1\n2\n1\n", "generation 1 comes more than once"),
        ("# s\ngeneration,n_segments\n1,2\n2,three\n", "line 4, column 'n_segments': 'three': .*valid number"),
        ("generation,n_segments\n1,nan\n", "line 2, column 'n_segments': 'nan': .*finite"),
        ("generation,n_segments\n1,-2\n", "line 2, column 'n_segments': '-2': .*greater than or equal to 0"),
        ("generation,branching_ratio_mean\n1,1.2\n", "'1.2': .*less than or equal to 1"),
        ("generation\n0\n", "line 2, column 'generation': '0': .*greater than or equal to 1"),
        ("generation\n1.5\n", "line 2, column 'generation': '1.5': .*valid integer"),
        ("generation,n_segments\n1\n", "line 2 has 1 cells for 2 columns; mend the line"),
        (b"generation\n\xff\n", "is not text in UTF-8; save the table as CSV in UTF-8"),
    ],
)
def test_a_faulty_published_table_is_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_reference_table(write(tmp_path, text))


def test_a_missing_published_table_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"nothing.csv: cannot be read \(No such file or directory\)"):
        read_reference_table(tmp_path / "nothing.csv")

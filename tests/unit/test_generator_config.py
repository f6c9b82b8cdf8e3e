import json

import pytest

from generator.config import Config, load, presets
from vascval.core.errors import InputError


def test_presets_are_the_papers_tables():
    assert presets() == ["karch-box", "portal-vein"]
    box = load("karch-box")
    assert (box.n_terminals, box.gamma, box.n_connections) == (6000, 2.55, 32)
    assert box.domain.box_mm == (90.0, 70.0, 16.0)
    assert box.flow().pressure_drop_pa == pytest.approx(40 * 133.322387415, rel=1e-12)  # a difference of two
    assert box.flow().flow_mm3_s == pytest.approx(500e3 / 60, rel=1e-15)
    liver = load("portal-vein")
    assert (liver.n_terminals, liver.gamma, liver.domain.shape) == (24000, 3.0, "liver")
    assert liver.flow().pressure_drop_pa == pytest.approx(4 * 133.322387415, rel=1e-12)


def test_keys_are_changed_one_by_one():
    config = load(
        "karch-box",
        ["n_terminals=500", "seed=7", "root_mm=1,2,3", "domain.box_mm=10,20,30", "growth.merge_mm=0.2", "gamma=3",
         "growth.avoid_intersections=true"],
    )  # fmt: skip
    assert (config.n_terminals, config.seed, config.gamma, config.root_mm) == (500, 7, 3.0, (1.0, 2.0, 3.0))
    assert config.domain.box_mm == (10.0, 20.0, 30.0)
    assert config.growth_options().merge_mm == 0.2
    assert config.growth_options().apart == 1.0
    assert load("karch-box", ["growth.merge_mm=0.2", "growth.merge_mm=none"]).growth.merge_mm is None


def test_a_domain_replaces_the_presets():
    assert load("portal-vein", ["domain.file=liver.stl", "domain.label=3"]).domain.shape is None


def test_two_domains_are_refused(tmp_path):
    text = 'n_terminals = 5\ngamma = 3.0\n[domain]\nshape = "ball"\nbox_mm = [1, 2, 3]\n'
    (tmp_path / "two.toml").write_text(text)
    with pytest.raises(InputError, match=r"domain: one of box_mm, file and shape is needed, not box_mm and shape"):
        load(str(tmp_path / "two.toml"))


def test_a_file_is_read_and_its_paths_are_relative_to_it(tmp_path):
    text = (
        'n_terminals = 5\ngamma = 3.0\nterminals_file = "points.csv"\n[domain]\nfile = "liver.nrrd"\n'
        "[perfusion]\nroot_pressure_mmhg = 10\nterminal_pressure_mmhg = 5\nflow_ml_min = 100\n"
    )
    (tmp_path / "run.toml").write_text(text)
    config = load(str(tmp_path / "run.toml"))
    assert config.domain.file == tmp_path / "liver.nrrd"
    assert config.terminals_file == tmp_path / "points.csv"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["n_terminal=5"], "n_terminal is no key of the configuration; the keys are method, seed"),
        (["domain.size=5"], "domain.size is no key of the configuration; the keys are box_mm, file"),
        (["n_terminals=0"], "n_terminals: input should be greater than or equal to 1"),
        (["n_terminals=many"], "n_terminals: input should be a valid integer"),
        (["gamma=4"], "gamma: input should be less than or equal to 3"),
        (["gamma=nan"], "gamma: input should be"),
        (["root_mm=1,2"], "root_mm.2 is missing|root_mm"),
        (["method=full", "growth.avoid_intersections=true"], "method=full lets vessels overlap; use method=geometry"),
        (["viscosity=fahraeus-lindqvist"], "growth alone knows constant viscosity"),
        (["n_terminals"], "--set n_terminals: is not key=value"),
        (["seed.x=1"], "--set seed.x=1: seed is a value, not a table"),
        (["perfusion.flow_ml_min=-1"], "perfusion.flow_ml_min: input should be greater than 0"),
        (["growth.at_r_min=never"], "growth.at_r_min: input should be 'stop' or 'error'"),
    ],
)
def test_wrong_values_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        load("karch-box", changes)


def test_wrong_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing: neither a file nor a preset; the presets are karch-box,"):
        load("nothing")
    (tmp_path / "bad.toml").write_text("n_terminals = = 5")
    with pytest.raises(InputError, match=r"bad.toml: is no valid TOML \(.*line 1"):
        load(str(tmp_path / "bad.toml"))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"binary.toml: cannot be read"):
        load(str(tmp_path / "binary.toml"))
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(InputError, match=r"empty.toml: n_terminals is missing; add it or begin with a preset"):
        load(str(tmp_path / "empty.toml"))
    with pytest.raises(InputError, match=r"cannot be read"):
        load(str(tmp_path))


def test_the_schema_describes_every_key():
    schema = json.dumps(Config.model_json_schema())
    for key in ("n_terminals", "box_mm", "flow_ml_min", "avoid_intersections", "terminals_file"):
        assert f'"{key}"' in schema

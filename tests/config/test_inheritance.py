"""Files that say only how they differ from another, and paths relative to where they stand."""

import pytest

from kedge.config.inheritance import merged, placed
from kedge.config.rigs import load_rig_config
from kedge.config.scenarios import load_scenario
from kedge.core.errors import ConfigError
from kedge.vehicles.underwater.coefficient_files import as_coefficients, as_toml


def written(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return str(path)


def test_tables_are_merged_and_lists_replaced():
    base = {"a": {"x": 1, "y": 2}, "b": [1, 2], "c": 3}
    changes = {"a": {"y": 5, "z": 6}, "b": [7]}
    assert merged(base, changes) == {"a": {"x": 1, "y": 5, "z": 6}, "b": [7], "c": 3}


def test_another_model_takes_nothing_over():
    base = {"model": "gnss", "rate": 5.0, "parameters": {"std": 1.0}}
    assert merged(base, {"rate": 1.0}) == base | {"rate": 1.0}
    assert merged(base, {"model": "depth"}) == {"model": "depth"}


def test_a_scenario_that_extends_another(tmp_path):
    """Grandchild, child of a shipped scenario; what is not said is the shipped one's."""
    written(tmp_path / "child.toml", 'extends = "yard"\n[scenario]\ndt = 0.05\nruns = 7\n')
    text = 'extends = "../child.toml"\nwithout = ["scenario.burn_in"]\n[scenario]\nruns = 3\n'
    setting = load_scenario(written(tmp_path / "below" / "own.toml", text))
    about, yard = setting.config.scenario, load_scenario("yard").config
    assert (about.dt, about.runs, about.duration) == (0.05, 3, yard.scenario.duration)
    assert setting.config.sensors == yard.sensors
    assert (about.burn_in, yard.scenario.burn_in) == (0.0, 10.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('extends = "yrad"', r"own\.toml: extends: found 'yrad', expected a TOML file or one"),
        ("extends = 3", r"own\.toml: extends: found 3, expected the name"),
        ('extends = "own.toml"', "which extends this file again"),
        ('extends = "yard"\nwithout = ["sensors.sonar"]', "'sensors.sonar', which is not in"),
        ('extends = "yard"\n[scenario]\nrnus = 3', r"own\.toml:3: scenario\.rnus: no key"),
    ],
)
def test_what_cannot_be_extended(tmp_path, text, said):
    with pytest.raises(ConfigError, match=said):
        load_scenario(written(tmp_path / "own.toml", text))


def test_paths_are_relative_to_the_file(tmp_path, monkeypatch):
    """A rig in one folder names the coefficients beside it; the user stands in another."""
    hull = as_coefficients("remus100-derived:Yvv=-222")
    written(tmp_path / "fleet" / "hull.toml", as_toml(hull, "hull", "this test"))
    rig = """
    control = { source = "commands" }
    [vehicle]
    model = "underwater"
    parameters = { coefficients = "hull.toml:Zww=-111" }
    [prior]
    std = { position = 1, attitude = 1, velocity_body = 1, angular_rate = 1 }
    """
    path = written(tmp_path / "fleet" / "rig.toml", rig)
    monkeypatch.chdir(tmp_path)
    found = load_rig_config(path).vehicle.parameters["coefficients"]
    assert as_coefficients(str(found)).values() == hull.values() | {"Zww": -111.0}
    with pytest.raises(ConfigError, match=r"hull\.toml: cannot be read"):
        load_rig_config(path, {"vehicle.parameters.coefficients": '"hull.toml"'})


def test_only_files_among_parameters_are_placed(tmp_path):
    tree = {"sensors": {"a": {"source": "b.toml", "parameters": {"kind": "rk4", "n": 3}}}}
    assert placed(tree, tmp_path) == tree
    absolute = {"parameters": {"coefficients": str(tmp_path / "x.toml")}}
    assert placed(absolute, tmp_path / "y") == absolute


@pytest.mark.parametrize("rig", ["navego_synthetic", "hanyang_uwb", "agv_amcl"])
def test_a_scenario_that_extends_a_rig_runs_at_once(rig, tmp_path):
    """What is about the log (format, control, truth, columns, the prior's pose) is left out."""
    maps = "[maps.anchors]\nids = ['a', 'b', 'c']\n[maps.anchors.columns]\n" + "".join(
        f"position_{axis} = {values}\n" for axis, values in (("x", [0, 9, 0]), ("y", [0, 0, 9]))
    )
    own = f"extends = {rig!r}\n{maps if rig == 'hanyang_uwb' else ''}[scenario]\nruns = 2\n"
    setting = load_scenario(written(tmp_path / "own.toml", own))
    config = load_rig_config(rig)
    about = setting.config.scenario
    assert (about.runs, about.title) == (2, config.title)
    assert about.filters == ["dead-reckoning", config.filter.name]
    assert setting.config.vehicle == config.vehicle
    assert setting.scenario.rig.names == tuple(config.sensors)


def test_a_map_from_a_log_is_missed(tmp_path):
    own = written(tmp_path / "own.toml", 'extends = "mrclam"\n[scenario]\nduration = 5.0\n')
    with pytest.raises(ConfigError, match=r"sensors.camera.map: .* has no log to take it from"):
        load_scenario(own)

from pathlib import Path

import jsonschema
import pytest

from kedge.config.rigs import load_rig_config, rig_schema, shipped_rigs
from kedge.core.errors import ConfigError, UnknownName
from kedge.formats.log_config import log_schema

RIG = """\
[vehicle]
model = "unicycle"
parameters = { speed_noise = 0.05 }

[control]
source = "odometry"

[sensors.camera]
model = "landmarks"
map = "landmarks"
gate = 0.01

[prior]
std = { position = 0.1, heading = 0.2 }
"""


def rig(tmp_path: Path, text: str = RIG) -> str:
    (tmp_path / "rig.toml").write_text(text)
    return str(tmp_path / "rig.toml")


def validation_error(tmp_path: Path, text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_rig_config(rig(tmp_path, text))
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "rig.toml"))
    return message


def test_defaults_and_overrides(tmp_path):
    config = load_rig_config(rig(tmp_path))
    assert (config.filter.name, config.output.rate, config.format) == (
        "extended",
        10.0,
        "folder",
    )
    assert config.origin == str(tmp_path / "rig.toml")

    changed = load_rig_config(
        rig(tmp_path),
        {
            "sensors.camera.gate": "0.05",
            "filter.name": "particle:count=10",
            "vehicle.augmented.speed_scale": "{ std = 0.05, random_walk = 0.001 }",
            "prior.std.position": "[1.0, 2.0]",
        },
    )
    assert changed.sensors["camera"].gate == 0.05
    assert changed.filter.name == "particle:count=10"
    assert changed.vehicle.augmented["speed_scale"].random_walk == 0.001
    assert changed.prior.std["position"] == [1.0, 2.0]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (
            "sensors.camera.gaet",
            "0.1",
            "sensors.camera.gaet: no key called 'gaet' (did you mean",
        ),
        ("sensors.camera.gate", "2", "sensors.camera.gate: found 2, expected less than 1"),
        ("filter.name", "[1", "--set filter.name=[1: found '[1', expected a TOML value"),
        ("a b", "1", "--set a b=1: found 'a b', expected a dotted key"),
        ("vehicle.model.x", "1", "vehicle.model is a value, not a table"),
    ],
)
def test_overrides_that_are_wrong(tmp_path, key, value, message):
    with pytest.raises(ConfigError) as caught:
        load_rig_config(rig(tmp_path), {key: value})
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "gate =",
            "gaet =",
            ":11: sensors.camera.gaet: no key called 'gaet' (did you mean 'gate'",
        ),
        ("[prior]", "[priro]", ":13: priro: no key called 'priro' (did you mean 'prior'"),
        (
            "gate = 0.01",
            'gate = "1%"',
            ":11: sensors.camera.gate: found '1%', expected a valid num",
        ),
        (
            "gate = 0.01",
            "gate = 0",
            ":11: sensors.camera.gate: found 0, expected greater than 0",
        ),
        ("gate = 0.01", "gate = nan", ":11: sensors.camera.gate: found nan, expected a finite"),
        (
            "speed_noise",
            "sped_noise",
            ":3: vehicle.parameters.sped_noise: no parameter of unicycle",
        ),
        (
            "unicycle",
            "hovercraft",
            ":2: vehicle.model: no vehicles called 'hovercraft'; there are",
        ),
        (
            "landmarks",
            "landmark",
            ":9: sensors.camera.model: no sensors called 'landmark' (did you",
        ),
        ('map = "landmarks"\n', "", ":8: sensors.camera.map: this key is missing"),
        (
            "gate = 0.01",
            "std = { range = 'r' }",
            ":11: sensors.camera.std: found ['range'], exp",
        ),
        (
            "gate = 0.01",
            "covariance = ['c']",
            ":11: sensors.camera.covariance: found 1 columns, ",
        ),
        (
            "gate = 0.01",
            "columns = { rng = 'r' }",
            "sensors.camera.columns.rng: no measurement com",
        ),
        (
            "[control]\nsource",
            "[output]\nrate = 'fast' #",
            "control: this key is missing; vehicle",
        ),
        (", heading = 0.2", "", "prior.std.heading: this key is missing"),
        (
            "heading = 0.2",
            "heading = 0.0",
            "prior.std.heading.0: found 0.0, expected greater than",
        ),
        (
            "position = 0.1",
            "position = [1, 2, 3]",
            "prior.std.position: found 3 numbers, expected",
        ),
        (
            "std = { pos",
            "mean = { roll = 1 }\nstd = { pos",
            ":14: prior.mean.roll: no field of the",
        ),
        (
            "std =",
            "from_truth = ['speed']\nstd =",
            "prior.from_truth.speed: no field of the state",
        ),
        (
            "[prior]",
            "[filter]\nname = 'extendet'\n[prior]",
            ":14: filter.name: no filters called",
        ),
        ("[prior]", "[vehicle]\n[prior]", ":13: no readable TOML: Cannot declare"),
    ],
)
def test_each_mistake_is_named_by_file_line_and_key(tmp_path, old, new, message):
    if "fast" in new:  # The rate is checked before what spans several tables.
        new = new.replace("'fast'", "5.0")
    assert message in validation_error(tmp_path, RIG.replace(old, new, 1))


def test_all_mistakes_at_once(tmp_path):
    text = RIG.replace("speed_noise", "noise").replace("gate = 0.01", "gate = 2\nrat = 1")
    lines = validation_error(tmp_path, text + "[output]\nrate = -1\n").splitlines()
    keys = [line.split(": ")[1] for line in lines]
    assert keys == [
        "vehicle.parameters.noise",
        "sensors.camera.gate",
        "sensors.camera.rat",
        "output.rate",
    ]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("[[1, 2, 0], [2, 1, 0], [0, 0, 1]]", "not positive definite: found the eigenvalue -1"),
        ("[[1, 0, 0], [0, 0, 0], [0, 0, 1]]", "not positive definite: found the eigenvalue 0"),
        ("[[1, 1, 0], [0, 1, 0], [0, 0, 1]]", "not symmetric"),
        ("[[1, 0], [0, 1]]", "expected 3 rows of 3 numbers"),
        ("[[1, 0, 0], [0, inf, 0], [0, 0, 1]]", "found inf, expected a finite number"),
    ],
)
def test_covariances_that_are_none(tmp_path, rows, message):
    text = RIG.replace("std = { position = 0.1, heading = 0.2 }", f"covariance = {rows}")
    assert message in validation_error(tmp_path, text)


def test_a_vehicle_without_control(tmp_path):
    text = RIG.replace("unicycle", "constant-velocity").replace(
        "speed_noise", "acceleration_noise"
    )
    text = text.replace("[control]\nsource", "[filter]\nname = 'extended' #")
    text = text.replace("heading", "velocity")
    assert load_rig_config(rig(tmp_path, text)).control is None


def test_rigs_by_name():
    assert "mrclam" in shipped_rigs()
    for name in shipped_rigs():
        assert load_rig_config(name).format
    with pytest.raises(UnknownName, match=r"no rig called 'mrclan' \(did you mean 'mrclam'"):
        load_rig_config("mrclan")
    with pytest.raises(ConfigError, match=r"none.toml: no such file"):
        load_rig_config("none.toml")


def test_the_schema_takes_what_the_loader_takes(tmp_path):
    schema = rig_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    check = jsonschema.Draft202012Validator(schema)
    config = load_rig_config(rig(tmp_path)).model_dump(mode="json", exclude_none=True)
    assert check.is_valid(config)
    assert check.is_valid(config | {"prior": {"std": {"position": 0.1, "heading": [0.1]}}})
    assert not check.is_valid(config | {"priro": {}})


def keys_of(schema):
    for name, table in {**schema["$defs"], "": schema}.items():
        for key, about in table.get("properties", {}).items():
            # A table may be described where its own keys are.
            inside = schema["$defs"].get(about.get("$ref", "").rpartition("/")[2], {})
            yield f"{name}.{key}", about.get("description") or inside.get("description")


@pytest.mark.parametrize("schema", [rig_schema, log_schema])
def test_every_key_is_described(schema):
    found = dict(keys_of(schema()))
    assert len(found) > 20
    assert [key for key, text in found.items() if not text] == []


def test_the_schema_of_a_log_takes_what_its_reader_takes():
    check = jsonschema.Draft202012Validator(log_schema())
    log = {"sources": {"wheels": {"columns": {"speed": "m/s", "w": {"unit": "deg/s"}}}}}
    assert check.is_valid(log)
    assert not check.is_valid({"sources": {"wheels": {"colums": {}}}})


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("vehicle.slow", "augmented"),
        ("sensors.camera.sweep", "all_targets"),
        ("sensors.camera.really", "true_parameters"),
    ],
)
def test_a_renamed_key_is_told_by_its_new_name(old, new):
    with pytest.raises(ConfigError, match=f"{old}: this key is called '{new}' now"):
        load_rig_config("mrclam", {old: "1"})

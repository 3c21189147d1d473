"""Scenario files: what is built from them, and all that is wrong with one at once."""

import numpy as np
import pytest

from kedge.config.scenarios import load_scenario, shipped_scenarios
from kedge.core.errors import ConfigError, ContractError, UnknownName


# Paper C's have a box across zero, to show what comes of it.
@pytest.mark.filterwarnings("ignore:fuzzy. the box straddles zero")
@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_can_be_built(name):
    config, scenario, _ = load_scenario(name)
    assert config.scenario.title
    assert scenario.steps > 0
    assert len(scenario.rig.sensors) == len(config.sensors)


def test_what_stands_in_the_file_is_what_is_built():
    config, scenario, _ = load_scenario("yard", {"scenario.spin_up": "3", "scenario.dt": "0.2"})
    assert (scenario.duration, scenario.dt, scenario.spin_up) == (60.0, 0.2, 3.0)
    (camera,) = scenario.rig.sensors
    assert (camera.name, camera.rate, camera.targets) == ("camera", 2.0, 3)
    np.testing.assert_allclose(camera.sensor.target.position[1], [-5.0, 15.0])
    np.testing.assert_allclose(np.diag(scenario.rig.prior.cov), [0.09, 0.09, 0.0025])
    assert config.scenario.filters[1] == "extended"


def test_large_systems_are_sized_by_the_file(tmp_path):
    path = tmp_path / "ring.toml"
    path.write_text(
        """
        [scenario]
        title = "a ring"
        source = "these tests"
        duration = 1.0
        filters = ["etkf:count=5"]
        [vehicle]
        model = "lorenz96"
        parameters = { size = 12 }
        [sensors.some]
        model = "components"
        parameters = { size = 12, stride = 3 }
        [prior]
        mean = { values = 2.5 }
        std = { values = 1 }
        """
    )
    rig = load_scenario(str(path)).scenario.rig
    np.testing.assert_array_equal(rig.prior.mean.values, np.full(12, 2.5))
    assert rig.sensors[0].sensor.dof() == 4
    with pytest.raises(ConfigError, match=r"size: found 12\.5, expected a whole number"):
        load_scenario(str(path), {"vehicle.parameters.size": "12.5"})
    with pytest.raises(ContractError, match=r"ring\.toml: .*reads"):
        load_scenario(str(path), {"sensors.some.parameters.size": "13"})


@pytest.mark.parametrize(
    ("changes", "lines"),
    [
        (
            {"scenario.runs": "0", "scenario.score": "best", "scenario.sed": "1"},
            ["runs: found 0", "score: found 'best'", r"no key called 'sed' \(did you mean"],
        ),
        (
            {"scenario.filters": '["extnded", "kalman", "kalman"]', "scenario.burn_in": "60"},
            [
                r"filters: no filters called 'extnded' \(did you mean 'extended'",
                "filters: found 'kalman' twice",
                "burn_in: found 60 s, expected less than the duration",
            ],
        ),
        ({"scenario.dt": "61"}, ["dt: found 61 s, expected at most the duration"]),
        ({"scenario.dt": "1e-6"}, ["dt: found 1e-06 s, which makes 6e"]),
        ({"scenario.filters": "[]"}, ["filters: found"]),
        (
            {"scenario.filters": '["kalman"]', "scenario.featured": '["kalman", "extended"]'},
            [r"featured: found \['extended'\], expected some of the filters, \['kalman'\]"],
        ),
        (
            {
                "sensors.camera.map": "pots",
                "sensors.camera.source": "x",
                "prior.from_truth": '["position"]',
                "prior.std.speed": "1",
                "published.extnded.rmse": "1",
            },
            [
                "sensors.camera.map: found 'pots'",
                "sensors.camera.source: a scenario reads no log",
                "prior.from_truth: a scenario has no log",
                "published: no filters called 'extnded'",
                "prior.std.speed: no field of the state called 'speed'",
            ],
        ),
    ],
)
def test_all_mistakes_are_said_at_once(changes, lines):
    with pytest.raises(ConfigError) as caught:
        load_scenario("yard", changes)
    said = str(caught.value).splitlines()
    assert len(said) == len(lines)
    for line in lines:
        with pytest.raises(ConfigError, match=line):
            raise caught.value
    assert all("yard.toml: " in line for line in said)


def test_an_unknown_scenario_names_those_that_exist():
    with pytest.raises(
        UnknownName, match=r"no scenario called 'yrad' \(did you mean 'yard'\?\)"
    ):
        load_scenario("yrad")


WORLD = """
[scenario]
title = "a robot"
source = "made for this test"
duration = 4.0
dt = 0.01
filters = ["extended"]
[world]
model = "omnidirectional"
parameters = { slip = 2.0 }
[world.route]
model = "circle"
facing = [1.0, 0.0]
parameters = { centre = [1.0, 0.0] }
[vehicle]
model = "omnidirectional"
parameters = { kinematics = "mirrored" }
[vehicles.kalman]
model = "omnidirectional"
parameters = { rule = "forward" }
[prior]
std = { position = 0.05, heading = 0.03 }
"""


def test_a_world_with_its_route_and_models_of_filters(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(WORLD)
    setting = load_scenario(str(path), {"scenario.feedback": "extended"})
    world = setting.scenario.world
    assert world.slip == 2.0
    place = world.route.at(10.0)
    np.testing.assert_allclose(place.position, [1.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(place.heading, np.pi / 2)
    assert setting.scenario.rig.vehicle.kinematics == "mirrored"
    assert setting.vehicles["kalman"].rule == "forward"
    assert setting.scenario.feedback == "filter"
    assert setting.scenario.loop_filter.name == "extended"


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("world.model", "omnidirectonal", "did you mean 'omnidirectional'"),
        ("world.parameters.slip", "much", "found 'much', expected a number"),
        ("world.parameters.slipp", "1.0", "did you mean 'slip'"),
        ("world.route.model", "circel", "did you mean 'circle'"),
        ("world.route.parameters.centre", "1.0", "found 1, expected a list"),
        ("world.route.model", "waypoints", "points: this key is missing"),
        ("vehicle.parameters.kinematics", "mirorred", "no kinematics called 'mirorred'"),
        ("vehicle.parameters.radius", "true", "found True, expected a number"),
        ("vehicles.kalmann.model", "omnidirectional", "no filters called 'kalmann'"),
        ("scenario.feedback", "exteded", "did you mean 'extended'"),
        ("world.model", "lane-keeping", "route: found a Facing, but world"),
    ],
)
def test_what_is_wrong_with_a_world_is_named(tmp_path, key, value, says):
    path = tmp_path / "robot.toml"
    path.write_text(WORLD)
    with pytest.raises(ConfigError, match=says):
        load_scenario(str(path), {key: value})


def test_a_route_that_is_needed_is_asked_for(tmp_path):
    path = tmp_path / "robot.toml"
    begin, end = WORLD.index("[world.route]"), WORLD.index("[vehicle]")
    path.write_text(WORLD[:begin] + WORLD[end:])
    with pytest.raises(ConfigError, match=r"world\.route: this key is missing"):
        load_scenario(str(path))


def test_faults_of_a_scenario():
    spec = (
        '{ on = "camera", model = "outliers", parameters = { scale = 20.0 }, '
        "windows = [[10.0, 20.0]], episodes = { rate = 0.2, duration = 2.0 } }"
    )
    (fault,) = load_scenario("yard", {"faults.bursts": spec}).scenario.faults
    assert (fault.name, fault.on, fault.windows) == ("bursts", "camera", ((10.0, 20.0),))
    assert (fault.kind.scale, fault.episodes.duration) == (20.0, 2.0)


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ('{ on = "camra", model = "dropout" }',
         r"faults\.it\.on: no sensor called 'camra' \(did you mean 'camera'"),
        ('{ on = "camera", model = "dropuot" }', "no faults called 'dropuot' .*'dropout'"),
        ('{ on = "camera", model = "dropout", parameters = { probability = 2.0 } }',
         "probability is 2, expected 0 to 1"),
        ('{ on = "camera", model = "delay", parameters = { dealy = 2.0 } }', "mean 'delay'"),
        ('{ on = "camera", model = "bias", parameters = { component = "deph" } }',
         "no component called 'deph'"),
        ('{ on = "camera", model = "stuck", windows = [[3.0, 2.0]] }', "expected the earlier"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_fault_is_named(spec, says):
    with pytest.raises(ConfigError, match=says):
        load_scenario("yard", {"faults.it": spec})

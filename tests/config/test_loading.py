"""Rigs and logs for programs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kedge
from kedge import filters, sensors, vehicles
from kedge.config.loading import as_overrides

RIG = """
[vehicle]
model = "constant-velocity"

[sensors.gnss]
model = "gnss"
source = "fixes"

[sensors.gnss.columns]
position_x = "east"
position_y = "north"

[prior]
std = { position = 1.0, velocity = 1.0 }
"""
ROWS = "0,0,0\n1,1,0.5\n2,2,1\n3,3,1.5\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "fixes.csv").write_text("time,east,north\n" + ROWS)
    (tmp_path / "log" / "gnss.csv").write_text("time,position_x,position_y\n" + ROWS)
    (tmp_path / "log" / "log.toml").write_text(
        '[sources.fixes]\ncolumns = { east = "m", north = "m" }\n'
        '[sources.gnss]\ncolumns = { position_x = "m", position_y = "m" }\n'
    )
    return tmp_path


def test_a_rig_knows_where_its_log_has_the_columns(folder):
    rig = kedge.load_rig(folder / "rig.toml", settings={"output.rate": 2})
    log = kedge.read_log(folder / "log", rig)
    assert len(log.outputs) == 6
    both = kedge.load(folder / "rig.toml", folder / "log", settings={"output.rate": 2})
    for one, other in zip((rig, log), both, strict=True):
        leaves = zip(kedge_leaves(one), kedge_leaves(other), strict=True)
        assert all(np.array_equal(a, b) for a, b in leaves)
    estimates = kedge.estimate(filters.Kalman(), rig, log)
    np.testing.assert_allclose(estimates.moments.mean.velocity[-1], [1, 0.5], atol=0.2)


def test_a_rig_made_in_python_reads_a_log_that_names_columns_as_it_does(folder):
    vehicle = vehicles.ConstantVelocity()
    prior = kedge.Gaussian(vehicle.start(), jnp.eye(4))
    rig = kedge.Rig(vehicle, (kedge.Installation("gnss", sensors.Gnss()),), prior)
    log = kedge.read_log(folder / "log", rig)
    np.testing.assert_array_equal(
        log.log.readings[0].measurement.position, [[0, 0], [1, 0.5], [2, 1], [3, 1.5]]
    )


def test_what_comes_from_the_log_needs_the_log(site):
    with pytest.raises(kedge.ConfigError, match=r"position.*kedge.load\(rig, log\)"):
        kedge.load_rig(site / "rig.toml")
    rig, log = kedge.load(site / "rig.toml", site / "log")
    assert log.truth is not None
    _, smoothed = kedge.smooth(filters.Extended(), rig, log)
    last = np.searchsorted(log.truth.time, 10.0)
    at = np.searchsorted(smoothed.time, 10.0)
    error = smoothed.moments.mean.position[at] - log.truth.fields["position"][last]
    assert np.linalg.norm(error) < 0.2


def test_settings_are_values_not_text():
    values = {"a": True, "b": 2, "c": 0.5, "d": "x", "e": [1, 2.0], "f": {"g": 1}}
    assert as_overrides(values) == {
        "a": "true", "b": "2", "c": "0.5", "d": '"x"', "e": "[1, 2.0]", "f": '{"g" = 1}'
    }  # fmt: skip


def kedge_leaves(tree):

    return jax.tree.leaves(
        tree._replace(notes=()) if isinstance(tree, kedge.Recording) else tree
    )

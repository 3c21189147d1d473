"""Controls that a log tells as counts or poses drive the vehicle as what made them did."""

import jax
import numpy as np
import pytest

import kedge
from kedge.config.problem import load_problem
from kedge.core.errors import ConfigError, DataError

STEPS, DT = 60, 0.1
LEFT, RIGHT = 700 + np.zeros(STEPS), 900 + np.zeros(STEPS)  # ticks a second of 1 mm
RIG = """
[vehicle]
model = "{model}"
[control]
source = "wheels"
sampling = "{sampling}"
{more}
[sensors.heading]
model = "heading"
[prior]
std = {{ position = 1e-3, heading = 1e-3 }}
[filter]
name = "dead-reckoning"
"""


def folder(tmp_path, columns, rig):
    """A log of wheels, and a compass that nobody heeds."""
    rows = np.column_stack(list(columns.values())).tolist()
    body = "".join(f"{k * DT:.1f},{','.join(map(repr, row))}\n" for k, row in enumerate(rows))
    (tmp_path / "wheels.csv").write_text(f"time,{','.join(columns)}\n{body}")
    (tmp_path / "heading.csv").write_text(
        "time,heading\n" + "".join(f"{k * DT:.1f},0\n" for k in range(STEPS + 1))
    )
    units = {"heading": "rad", "left": "1", "right": "1"}
    said = ", ".join(f'{name} = "{units.get(name, "m")}"' for name in columns)
    (tmp_path / "log.toml").write_text(
        f"[sources.wheels]\ncolumns = {{ {said} }}\n"
        '[sources.heading]\ncolumns = { heading = "rad" }\n'
    )
    (tmp_path / "rig.toml").write_text(rig)
    return str(tmp_path / "rig.toml"), str(tmp_path)


def circle():
    """Where the middle of the axle is, by the circle on which it drives."""
    speed, rate = 0.8, (0.9 - 0.7) / 0.5
    heading = rate * DT * np.arange(STEPS + 1)
    x, y = speed / rate * np.sin(heading), speed / rate * (1 - np.cos(heading))
    return x, y, heading


def driven(rig, log):
    problem = load_problem(rig, log)
    estimates = kedge.estimate(
        kedge.make_filter("dead-reckoning"), problem.rig, problem.recording.log
    )
    return jax.tree.map(lambda leaf: np.asarray(leaf)[-1], estimates.moments.mean)


def test_counts_that_flow_over_drive_on_a_circle(tmp_path):
    counts = {
        name: np.append(0, np.cumsum(rate * DT)) % 256
        for name, rate in (("left", LEFT), ("right", RIGHT))
    }
    rig = RIG.format(model="odometry", sampling="counts", more="counter = 256")
    end = driven(*folder(tmp_path, counts, rig))
    x, y, heading = circle()
    np.testing.assert_allclose(end.position, [x[-1], y[-1]], atol=1e-9)
    np.testing.assert_allclose(end.heading, heading[-1], atol=1e-9)


def test_counts_of_which_some_are_missing_drive_as_all_do(tmp_path):
    counts = {
        name: np.append(0, np.cumsum(rate * DT))
        for name, rate in (("left", LEFT), ("right", RIGHT))
    }
    counts["left"][[20, 21, 40]] = np.nan
    rig, log = folder(
        tmp_path, counts, RIG.format(model="odometry", sampling="counts", more="")
    )
    end, (_, _, heading) = driven(rig, log), circle()
    np.testing.assert_allclose(end.heading, heading[-1], atol=1e-9)
    assert f"control: 3 of {STEPS + 1} rows lack a number" in "".join(
        load_problem(rig, log).notes
    )


def test_an_increment_that_is_missing_is_refused(tmp_path):
    ways = {"left": LEFT * DT, "right": RIGHT * DT}
    ways["right"][20] = np.nan
    rig = RIG.format(model="odometry", sampling="increments", more="")
    with pytest.raises(DataError, match=r"found nothing, .* a control must be complete"):
        load_problem(*folder(tmp_path, ways, rig))


def test_poses_of_an_odometry_drive_wherever_its_frame_is(tmp_path):
    x, y, heading = circle()
    turned = (x + 1j * y) * np.exp(2j) + 50 - 20j
    angles = (heading + 2 + np.pi) % (2 * np.pi) - np.pi
    poses = {"position_x": turned.real, "position_y": turned.imag, "heading": angles}
    rig = RIG.format(model="planar-twist", sampling="poses", more="")
    end = driven(*folder(tmp_path, poses, rig))
    np.testing.assert_allclose(end.position, [x[-1], y[-1]], atol=1e-9)
    np.testing.assert_allclose(end.heading, heading[-1], atol=1e-9)


@pytest.mark.parametrize(
    ("model", "sampling", "more", "message"),
    [
        ("odometry", "poses", "", "poses tell no left"),
        ("unicycle", "previous", "counter = 256", 'this key goes with "counts"'),
        (
            "planar-twist",
            "poses",
            'columns = { yaw_rate = "w" }',
            "no control component called",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(model, sampling, more, message, tmp_path):
    (tmp_path / "rig.toml").write_text(RIG.format(model=model, sampling=sampling, more=more))
    with pytest.raises(ConfigError, match=message):
        load_problem(str(tmp_path / "rig.toml"), str(tmp_path))

"""An anchor whose ranges are too long is named, by its id and by how much."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kedge
from kedge.estimation.log import Readings
from kedge.evaluation.by_target import targets_off
from kedge.reports.findings import units_of, warnings
from kedge.reports.tables import target_table
from kedge.sensors.ranges import Anchor, Ranges

CORNERS = np.array([[0.0, -20.0], [60.0, -20.0], [60.0, 40.0], [0.0, 40.0]])
NAMES = ("a", "b", "c", "d")


def drive(gate):
    vehicle = kedge.make_vehicle("unicycle", speed_noise=0.05, yaw_rate_noise=0.01)
    radio = kedge.Installation(
        "radio", Ranges(target=Anchor(CORNERS), range_std=0.1), rate=10.0, gate=gate
    )
    rig = kedge.Rig(vehicle, (radio,), kedge.Gaussian(vehicle.start(), 0.01 * jnp.eye(3)))
    return rig, kedge.record(kedge.Scenario(rig, duration=60.0), jax.random.key(3))


def scored(rig, recording, longer):
    """The third anchor's ranges are longer than they should be."""
    (found,) = recording.log.readings
    wrong = found.measurement.range + longer * (found.target == 2)
    readings = Readings(type(found.measurement)(wrong), found.target)
    recording = recording._replace(log=recording.log._replace(readings=(readings,)))
    estimates = kedge.estimate(kedge.make_filter("extended"), rig, recording.log)
    return kedge.score(
        "extended", estimates, recording, rig, targets={"radio": NAMES}
    ), recording


@pytest.mark.parametrize("gate", [None, 0.001])
def test_an_injected_bias_is_named(gate):
    rig, (recording, _) = drive(gate)
    run, recording = scored(rig, recording, 0.5)
    worst = targets_off(run.scores, units_of(rig))[0]
    assert (worst.sensor, worst.target, worst.component) == ("radio", "c", "range")
    # Of 0.5 m: the estimate gives way to the bias, without a gate by more than half of it.
    assert (0.25 if gate else 0.15) < worst.median < 0.55
    said = [line for line in warnings([run], recording, rig) if "radio: c is off" in line]
    assert len(said) == 1
    rows = {row[0]: row for row in target_table(run.scores, units_of(rig))}
    assert rows["radio: c"][-1] == "yes"


def test_honest_anchors_are_not():
    rig, (recording, _) = drive(0.001)
    run, _ = scored(rig, recording, 0.0)
    targets = run.scores.sensors["radio"].targets
    assert list(targets) == list(NAMES)
    assert sum(entry.readings for entry in targets.values()) == 600
    assert not targets_off(run.scores, units_of(rig))
    spreads = [entry.residuals["range"].spread for entry in targets.values()]
    np.testing.assert_allclose(spreads, 0.1, rtol=0.35)

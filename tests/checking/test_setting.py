"""What a hypothesis makes of a rig and its log."""

import jax
import numpy as np
import pytest

from kedge.checking.planted import PLANTED, planted
from kedge.checking.setting import Change, changed, setting_of
from kedge.core.errors import ConfigError
from kedge.tuning.tunable import tunables


@pytest.fixture(scope="module")
def setting():
    recording, rig = planted(None, jax.random.key(1), duration=5.0)
    return setting_of(rig, recording, tuple(t for t in tunables(rig) if t.is_noise))


def test_a_scale_is_taken_out_of_the_readings_and_paid_for(setting):
    """Readings 1.25 times too large shrink; where NIS is as it should be, so does density."""
    mended = changed(setting, Change("scale", "radio", "range", 0.25))
    before, after = (s.line.readings[1].measurement.range for s in (setting, mended))
    np.testing.assert_allclose(after, np.asarray(before) / 1.25)
    np.testing.assert_allclose(mended.density, [0, np.log(1 / 1.25)])
    careful = setting._replace(square=np.array([[1.0, 1.0], [0.25, 1.0]]))
    mended = changed(careful, Change("scale", "radio", "range", 0.25))
    np.testing.assert_allclose(mended.density, [0, 0.25 * np.log(1 / 1.25)])


def test_a_sign_of_the_control(setting):
    mended = changed(setting, Change("sign", "control", "yaw_rate"))
    before, after = setting.line.controls, mended.line.controls
    np.testing.assert_allclose(after.yaw_rate, -np.asarray(before.yaw_rate))
    np.testing.assert_allclose(after.speed, before.speed)


def test_a_clock_moves_readings_to_when_they_were_taken(setting):
    mended = changed(setting, Change("clock", "gnss", value=0.15))
    when = [np.asarray(s.log().schedule.time) for s in (setting, mended)]
    which = [np.asarray(s.log().schedule.sensor) for s in (setting, mended)]
    np.testing.assert_allclose(when[1][which[1] == 0], when[0][which[0] == 0] - 0.15)
    np.testing.assert_allclose(when[1][which[1] == 1], when[0][which[0] == 1])
    assert (np.diff(when[1]) >= -1e-9).all()


def test_noise_and_arm_change_the_rig_alone(setting):
    mended = changed(setting, Change("noise", "radio", value=np.log(3.0)))
    assert float(mended.rig.sensors[1].sensor.range_std) == pytest.approx(0.3)
    mended = changed(setting, Change("arm", "gnss", "x", 0.3))
    assert mended.rig.sensors[0].mount.x == pytest.approx(0.3)
    assert mended.line is setting.line


def test_exchanged_targets_are_exchanged_back(setting):
    mended = changed(setting, Change("exchange", "radio", "0,1"))
    back = changed(mended, Change("exchange", "radio", "0,1"))
    targets = [np.asarray(s.line.readings[1].target) for s in (setting, mended, back)]
    assert (targets[0] != targets[1]).any()
    np.testing.assert_array_equal(targets[0], targets[2])


def test_a_fault_that_cannot_be_planted_is_refused(key):
    with pytest.raises(ConfigError, match="clock off"):
        planted("clock of", key)


def test_each_fault_that_is_planted_changes_the_log(key):
    good, _ = planted(None, key, duration=2.0)
    for fault in PLANTED:
        if fault == "stuck sensor":  # from 70 s on
            continue
        log, _ = planted(fault, key, duration=2.0)
        pairs = zip(jax.tree.leaves(good.log), jax.tree.leaves(log.log), strict=True)
        assert any(not np.array_equal(a, b) for a, b in pairs), fault

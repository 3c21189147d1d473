"""Who stands: the wheel and the IMU have to agree."""

from pathlib import Path

import numpy as np

from kedge.config.rigs import StandingConfig
from kedge.config.standing import with_standing
from kedge.formats.logs import RawLog
from kedge.formats.tables import Table

SECOND = 1_000_000_000


def log(speed, shake):
    """20 s at 100 Hz; ``speed`` and ``shake`` are functions of the time."""
    random = np.random.default_rng(1)
    time = np.arange(2000) * 0.01
    stamps = np.round(time * SECOND).astype(np.int64)
    noise = random.normal(size=(2000, 6)) * (0.02 + shake(time))[:, None]
    names = [f"{stem}_{axis}" for stem in ("specific_force", "angular_rate") for axis in "xyz"]
    columns = dict(zip(names, (noise * [1, 1, 1, 0.1, 0.1, 0.1]).T, strict=True))
    units = {name: "m/s^2" if "force" in name else "rad/s" for name in names}
    lines = np.arange(2000)
    imu = Table("imu", Path("imu.csv"), stamps, columns, {}, lines, units)
    wheel = Table(
        "wheel", Path("wheel.csv"), stamps, {"speed": speed(time)}, {}, lines, {"speed": "m/s"}
    )
    return RawLog("made up", {"imu": imu, "wheel": wheel})


def standing(raw):
    found = with_standing(StandingConfig(wheel="wheel"), raw, "rig.toml").tables["standing"]
    assert not np.any(list(found.columns.values()))
    return found.stamps / SECOND


def still(time):
    return 0.0 * time


def drives(time):
    return np.where((time >= 5) & (time < 15), 1.0, 0.0)


def test_it_stands_before_and_after_the_drive_and_a_window_has_to_pass():
    found = standing(log(drives, drives))
    assert found.min() == 1.0
    assert not ((found >= 5) & (found < 16)).any()
    np.testing.assert_allclose(np.sum(found < 5), 40, atol=1)
    np.testing.assert_allclose(np.sum(found > 15), 39, atol=2)


def test_a_dead_encoder_does_not_freeze_the_filter():
    found = standing(log(still, drives))
    assert not ((found >= 5.1) & (found < 15.9)).any()


def test_a_smooth_glide_is_no_standing():
    assert not ((found := standing(log(drives, still))) >= 5).all()
    assert not ((found >= 5) & (found < 16)).any()


def test_a_silent_wheel_is_no_standing():
    raw = log(still, still)
    wheel = raw.tables["wheel"]
    quiet = raw._replace(tables={**raw.tables, "wheel": wheel.take(np.arange(500))})
    assert standing(quiet).max() < 6.1

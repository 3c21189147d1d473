"""Allan deviations against closed forms, and the recovery of what was simulated."""

import json

import jax
import numpy as np
import pytest

from kedge.calibration.allan import AllanCurve, AllanFit, allan, fit
from kedge.core.errors import DataError
from kedge.simulation.imu import PRESETS, ImuModel, errors, preset

PERIOD = 0.1


def test_a_ramp_has_its_closed_form():
    """For a rate R the Allan deviation is R tau / sqrt(2), exactly."""
    curve = allan(0.3 * PERIOD * np.arange(4000), PERIOD)
    np.testing.assert_allclose(curve.deviation, 0.3 * curve.tau / np.sqrt(2), rtol=1e-9)


def test_a_square_wave_has_its_closed_form():
    """Samples that alternate by +-1: sigma is 1 at one period, nothing at two."""
    curve = allan(np.resize([1.0, -1.0], 4096), PERIOD)
    assert curve.deviation[0] == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert curve.deviation[np.isclose(curve.tau, 2 * PERIOD)] == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slope", "part"), [(-0.5, "noise"), (0.0, "instability"), (0.5, "walk")]
)
def test_each_kind_of_noise_has_its_slope_and_is_recovered(slope, part):
    """Of 200,000 samples on three axes."""
    alone = {
        "noise": (0.02, 0.0, 0.0),
        "instability": (0.0, 0.01, 0.0),
        "walk": (0.0, 0.0, 0.003),
    }
    noise, level, walk = alone[part]
    model = ImuModel(noise, 0.0, level, 0.0, walk, 0.0, 0.0, 0.0)
    rates = np.asarray(errors(model, 200_000, PERIOD, jax.random.key(3)).angular_rate)
    curves = [allan(rates[:, axis], PERIOD) for axis in range(3)]
    mean = np.mean([np.log(curve.deviation) for curve in curves], axis=0)
    early = curves[0].tau < 200.0
    if part == "instability":
        early &= curves[0].tau > 2.0
    found = np.polyfit(np.log(curves[0].tau[early]), mean[early], 1)[0]
    assert found == pytest.approx(slope, abs=0.06)
    true = AllanFit(noise, level, walk)
    # Flicker is made up of processes from 0.25 s on.
    known = [AllanCurve(c.tau[early], c.deviation[early], c.freedom[early]) for c in curves]
    assert getattr(fit(known), part) == pytest.approx(getattr(true, part), rel=0.1)


@pytest.mark.slow
def test_all_three_are_recovered_together():
    model = preset("mpu6050")._replace(
        gyroscope_noise=1e-3, gyroscope_instability=1e-3, gyroscope_walk=5e-5
    )
    rates = np.asarray(errors(model, 200_000, PERIOD, jax.random.key(4)).angular_rate)
    found = fit([allan(rates[:, axis], PERIOD) for axis in range(3)])
    assert found.noise == pytest.approx(1e-3, rel=0.1)
    assert found.instability == pytest.approx(1e-3, rel=0.1)
    assert found.walk == pytest.approx(5e-5, rel=0.1)


def test_a_short_record_is_refused():
    with pytest.raises(DataError, match="found 10 samples, expected at least 64"):
        allan(np.zeros(10), PERIOD)


def test_presets_are_in_si_units():
    """Data sheets: 0.005 deg/s/sqrt(Hz), 400 ug/sqrt(Hz); 2 deg/sqrt(h), 0.2 m/s/sqrt(h)."""
    assert PRESETS["mpu6050"].gyroscope_noise == pytest.approx(8.7266e-5, rel=1e-4)
    assert PRESETS["mpu6050"].accelerometer_noise == pytest.approx(3.9227e-3, rel=1e-4)
    assert PRESETS["adis16405"].gyroscope_noise == pytest.approx(5.8178e-4, rel=1e-4)
    assert PRESETS["adis16405"].accelerometer_noise == pytest.approx(3.3333e-3, rel=1e-4)
    assert PRESETS["adis16465"].gyroscope_noise == pytest.approx(4.3633e-5, rel=1e-4)


def test_the_command_writes_table_and_figure(tmp_path, capsys):
    from kedge.apps.allan import execute, print_allan

    log = tmp_path / "log"
    log.mkdir()
    (log / "log.toml").write_text(
        '[sources.imu]\ntime_unit = "s"\n[sources.imu.columns]\n'
        'angular_rate_x = "deg/s"\nangular_rate_y = "deg/s"\n'
    )
    rates = np.random.default_rng(2).normal(0, 1.0, (2000, 2))
    rows = [f"{k * 0.01:.2f},{a:.9g},{b:.9g}" for k, (a, b) in enumerate(rates)]
    (log / "imu.csv").write_text("\n".join(["time,angular_rate_x,angular_rate_y", *rows]))
    summary = execute(str(log), "folder", None, tmp_path / "out")
    found = summary["signals"]["angular_rate"]
    # White noise of 1 deg/s at 100 Hz: N = 0.1 deg/s/sqrt(Hz).
    assert found["noise"] == pytest.approx(np.radians(0.1), rel=0.05)
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["samples"] == 2000
    assert (tmp_path / "out" / "figures" / "allan.png").stat().st_size > 10_000
    assert (tmp_path / "out" / "table.csv").read_text().startswith("tau,angular_rate_x")
    print_allan(summary)
    assert "angular_rate (rad/s, 2000 samples at 100 Hz)" in capsys.readouterr().out

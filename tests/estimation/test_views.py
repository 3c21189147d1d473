"""Estimates as a table, as a drawing, in a notebook; the likelihood of a log."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kedge
from kedge import filters, sensors, vehicles


@pytest.fixture(scope="module")
def run():
    vehicle = vehicles.ConstantVelocity()
    start = vehicle.start()
    prior = kedge.Gaussian(start, jnp.diag(jnp.array([1.0, 1.0, 0.25, 0.25])))
    rig = kedge.Rig(vehicle, (kedge.Installation("gnss", sensors.Gnss()),), prior)
    scenario = kedge.Scenario(rig, duration=5.0, dt=0.5)
    recording, truth = kedge.record(scenario, jax.random.key(3), output_rate=2.0)
    return rig, recording._replace(truth=truth)


def test_a_row_for_each_event(run):
    estimates = kedge.estimate(filters.Kalman(), *run)
    table = estimates.to_pandas()
    assert len(table) == len(run[1].stamps)
    assert table.index.name == "time"
    np.testing.assert_array_equal(table["velocity_y"], estimates.moments.mean.velocity[:, 1])
    np.testing.assert_allclose(
        table["position_x_std"] ** 2, estimates.moments.cov[:, 0, 0], rtol=1e-12
    )
    fused = table["verdict"] == "fused"
    assert fused.sum() == 5
    assert table["nis"].notna().equals(fused)
    assert float(estimates.log_likelihood) == pytest.approx(
        table["log_likelihood"][fused].sum()
    )


def test_the_likelihood_is_that_of_all_readings_at_once(run):
    """Of positions at rest, all readings together are one normal vector."""
    from scipy.stats import multivariate_normal

    rig, recording = run
    still = kedge.Rig(
        vehicles.ConstantVelocity(acceleration_noise=0.0), rig.sensors,
        kedge.Gaussian(rig.prior.mean, jnp.diag(jnp.array([4.0, 4.0, 0.0, 0.0]))),
    )  # fmt: skip
    readings = np.asarray(recording.log.readings[0].measurement.position)
    offset = readings - np.asarray(still.prior.mean.position)
    velocity = np.asarray(still.prior.mean.velocity)
    at = np.asarray(recording.log.schedule.time)[np.asarray(recording.log.schedule.sensor) == 0]
    count = len(readings)
    cov = 4.0 + float(sensors.Gnss().std) ** 2 * np.eye(count)
    expected = sum(
        multivariate_normal(velocity[axis] * at, cov).logpdf(offset[:, axis]) for axis in (0, 1)
    )
    found = kedge.estimate(filters.Kalman(), still, recording).log_likelihood
    assert float(found) == pytest.approx(expected, rel=1e-9)


def test_it_draws_into_the_axes_that_it_is_given(run):
    pyplot = pytest.importorskip("matplotlib.pyplot")
    estimates = kedge.estimate(filters.Kalman(), *run)
    figure, (left, right) = pyplot.subplots(1, 2)
    assert estimates.plot(ax=left) is left
    (track,) = left.lines
    np.testing.assert_array_equal(track.get_xdata(), estimates.moments.mean.position[:, 0])
    estimates.plot(ax=right, field="velocity")
    assert [line.get_label() for line in right.lines] == ["velocity_x", "velocity_y"]
    assert right.get_ylabel() == "velocity (m/s)"
    pyplot.close(figure)
    with pytest.raises(kedge.ContractError, match="no field 'heading'; there are position"):
        estimates.plot(ax=left, field="heading")


def test_a_notebook_shows_what_became_of_the_readings(run):
    page = kedge.estimate(filters.Kalman(), *run)._repr_html_()
    assert "fused 5" in page
    assert "last velocity" in page


def test_of_many_runs_one_has_to_be_taken_first(run):
    rig, recording = run
    log = recording.log
    many = log._replace(
        controls=jax.tree.map(lambda leaf: jnp.stack([leaf] * 2), log.controls),
        readings=jax.tree.map(lambda leaf: jnp.stack([leaf] * 2), log.readings),
    )
    estimates = kedge.estimate_runs(filters.Kalman(), rig, many)
    assert estimates.log_likelihood.shape == (2,)
    with pytest.raises(kedge.ContractError, match="many runs"):
        estimates.to_pandas()
    assert "(2, " in estimates._repr_html_()

"""Augmented states beside a vehicle's state."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Ensemble, Gaussian, Particles
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.filters.gaussian.square_root import SqrtGaussian
from kedge.sensors.gnss import Gnss
from kedge.sensors.landmarks import Landmarks
from kedge.testing import quick_jit
from kedge.vehicles.augmented import Drift, augment
from kedge.vehicles.constant_velocity import ConstantVelocity
from kedge.vehicles.unicycle import Control, Unicycle

SLOW = {
    "speed_scale": Drift(0.05),
    "range_scale": Drift(0.01, time_constant=2.0),
    "bearing_bias": Drift(),
}


@pytest.fixture(scope="module")
def vehicle():
    return augment(Unicycle(speed_scale=1.2), SLOW, (Landmarks(),))


def test_state_and_noise_are_wider_by_the_slow_quantities(vehicle):
    start = vehicle.start()
    names = ("position_x", "position_y", "heading", *SLOW)
    assert space(start).labels == names
    assert space(start).units[3:] == ("1", "1", "rad")
    # Nominal values: the vehicle's own parameter, the sensor's defaults.
    assert tuple(map(float, start[2:])) == (1.2, 1.0, 0.0)
    density = vehicle.noise_density()
    np.testing.assert_allclose([float(d) for d in density], [0.1, 0.02, 0.05, 0.01, 0.0])


def test_without_slow_quantities_it_is_the_vehicle_itself():
    vehicle = Unicycle()
    assert augment(vehicle, {}, ()) is vehicle


def test_a_slow_quantity_takes_the_place_of_the_parameter(vehicle):
    @quick_jit
    def both(scale):
        control, calm = Control(2.0, 0.3), space(vehicle.noise_density())
        state = vehicle.start()._replace(speed_scale=scale)
        one = vehicle.step(state, control, calm.unflatten(calm.zeros()), 0.5)
        plain = Unicycle(speed_scale=scale)
        return one, plain.step(plain.start(), control, Control(0.0, 0.0), 0.5)

    one, other = both(0.7)
    np.testing.assert_allclose(one.position, other.position, rtol=1e-15)
    assert one.speed_scale == 0.7


def test_a_time_constant_draws_back_to_the_nominal_value(vehicle):
    @quick_jit
    def after(scale, noise):
        density = space(vehicle.noise_density())
        state = vehicle.start()._replace(range_scale=scale)
        return vehicle.step(state, Control(0.0, 0.0), density.unflatten(noise), 2.0)

    calm = after(1.5, np.zeros(5))
    np.testing.assert_allclose(calm.range_scale, 1 + 0.5 * np.exp(-1))
    # Drawn with std walk / sqrt(dt) and held for dt; walk^2 tau / 2 (1 - exp(-2 dt / tau)).
    pushed = after(1.5, np.array([0, 0, 0, 0.01 / np.sqrt(2.0), 0]))
    exact = 0.01 * np.sqrt(1 - np.exp(-2.0))
    np.testing.assert_allclose(pushed.range_scale - calm.range_scale, exact)


def test_the_state_type_is_one_for_equal_arguments(vehicle):
    again = augment(Unicycle(), SLOW, (Landmarks(),))
    assert type(again.start()) is type(vehicle.start())
    assert jax.tree.structure(again.start()) == jax.tree.structure(vehicle.start())


@pytest.mark.parametrize(
    ("model", "slow", "message"),
    [
        (Unicycle(), "speed_scal", r"'speed_scal' is neither .* there are .*speed_scale"),
        (Unicycle(), "heading", "'heading' is in the vehicle's state already"),
        (ConstantVelocity(), "speed_scale", "there are acceleration_noise, bearing_bias"),
    ],
)
def test_a_slow_quantity_that_nothing_reads_is_refused(model, slow, message):
    with pytest.raises(ContractError, match=message):
        augment(model, {slow: Drift()}, (Gnss(), Landmarks()))


def test_a_reading_with_a_wrong_scale_is_told_by_the_state(vehicle):
    state = vehicle.start()._replace(position=jnp.array([17.0, 26.0]), range_scale=1.1)
    seen = quick_jit(lambda s: Landmarks().for_target(0).expect(s))(state)
    np.testing.assert_allclose(seen.range, 1.1 * 5)  # the landmark stands 3 m east, 4 m north


def forms_of(belief):
    """The same moments in every form that a filter carries; members drawn with a fixed seed."""
    states = space(belief.mean)
    draws = np.random.default_rng(1).normal(size=(500, states.size))
    members = jax.vmap(states.boxplus, (None, 0))(
        belief.mean, draws @ np.linalg.cholesky(belief.cov).T
    )
    yield belief
    yield SqrtGaussian(belief.mean, jnp.linalg.cholesky(belief.cov))
    yield Ensemble.of(members)
    yield Particles(members, jnp.full(500, -jnp.log(500.0)))


def test_who_is_lost_keeps_his_instruments(vehicle):
    """Widening multiplies the vehicle's own covariance; that of augmented states stays."""
    size = space(vehicle.start()).size
    factor = np.random.default_rng(0).normal(size=(size, size))
    belief = Gaussian(vehicle.start(), jnp.asarray(0.001 * factor @ factor.T))
    own = 3  # position and heading
    grown = np.where(np.arange(size) < own, 5.0, 1.0)
    for form in forms_of(belief):
        before, after = form.moments(), form.inflated(25.0).moments()
        np.testing.assert_allclose(after.cov, before.cov * np.outer(grown, grown), rtol=1e-9)
        np.testing.assert_allclose(
            space(after.mean).boxminus(after.mean, before.mean), 0.0, atol=1e-9
        )

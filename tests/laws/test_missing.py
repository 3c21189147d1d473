"""What is missing is as if it had not been measured (law 6), for every filter."""

from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.manifolds import Euclidean
from kedge.core.quantities import Bearing, Position, Range
from kedge.core.registry import filters
from kedge.estimation.log import Readings
from kedge.estimation.reading import bind_reading
from kedge.estimation.rig import Installation
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.unscented import UnscentedKalman
from kedge.sensors import landmarks
from kedge.sensors.gnss import Gnss, Measurement
from kedge.sensors.landmarks import Landmark, Landmarks
from kedge.sensors.landmarks import Measurement as Sight
from kedge.testing import quick_jit
from kedge.vehicles import constant_velocity, unicycle

BELIEF = Gaussian(
    constant_velocity.State(jnp.array([0.3, -0.2]), jnp.array([1.0, 0.5])),
    jnp.array(
        [[2.0, 0.5, 0.3, 0.0], [0.5, 1.0, 0.0, 0.2], [0.3, 0.0, 0.4, 0.1], [0.0, 0.2, 0.1, 0.5]]
    ),
)
COV = np.array([[0.8, 0.3], [0.3, 0.5]])


class OneAxis(NamedTuple):
    position: Annotated[Any, Euclidean("m", (1,))]


class Dummy(NamedTuple):
    position: Position


class Reads(NamedTuple):
    position: Position


class Axis(AbstractSensor[OneAxis]):
    """Reads one axis of the position."""

    axis: int
    variance: float
    reads = Reads
    measures = OneAxis

    def observe(self, state):
        return OneAxis(state.position[self.axis][None])

    def noise_std(self, state):
        return OneAxis(jnp.sqrt(jnp.array([self.variance])))


class Padded(AbstractSensor[Dummy]):
    """Reads one axis of the position, and beside it a constant, which tells nothing.

    A filter that draws noise for each component of a measurement then draws the same.
    """

    axis: int
    variance: float
    reads = Reads
    measures = Dummy

    def observe(self, state):
        return Dummy(jnp.where(jnp.arange(2) == self.axis, state.position, 0.0))

    def noise_std(self, state):
        return Dummy(jnp.where(jnp.arange(2) == self.axis, jnp.sqrt(self.variance), 1.0))


@pytest.mark.parametrize("name", filters.names())
def test_half_a_reading_is_that_of_a_sensor_with_half(name, key):
    """A GNSS fix without its first, then without its second coordinate; it brings its own
    covariance, of which only the part that is there may count."""
    filter = filters.make(name).bind_sensors(("gnss", ""))  # the sensors with half have no name
    drawing = name == "ensemble"

    @quick_jit
    def both(key):
        belief = filter.init(BELIEF, jr.fold_in(key, 1))
        found = []
        for missing in range(2):
            place = jnp.array([1.5, 0.4]).at[missing].set(jnp.nan)
            reading = Readings(Measurement(place), jnp.asarray(0), jnp.asarray(COV))
            partly = filter.update(
                *_first(bind_reading(Installation("gnss", Gnss()), reading), belief), key
            )
            there = 1 - missing
            seen, variance = (1.5, 0.4)[there], COV[there, there]
            if drawing:
                sensor, value = Padded(there, variance), Dummy(jnp.zeros(2).at[there].set(seen))
            else:
                sensor, value = Axis(there, variance), OneAxis(jnp.array([seen]))
            found.append((partly, filter.update(sensor, belief, value, key), there))
        return [
            ((a.moments(), s.nis, s.log_likelihood), (b.moments(), t.nis, t.log_likelihood))
            for (a, s), (b, t), _ in found
        ]

    for partly, reduced in both(key):
        if (
            drawing
        ):  # its padded sensor counts the constant as a component, with density 1/sqrt(2 pi)
            moments, nis, density = reduced
            reduced = moments, nis, density + 0.5 * np.log(2 * np.pi)
        for a, b in zip(*map(jax.tree.leaves, (partly, reduced)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-12)


def _first(sighted, belief):
    model, measurement = sighted
    return model, belief, measurement


class Distance(NamedTuple):
    range: Range


class Angle(NamedTuple):
    bearing: Bearing


MAP = Landmark(np.array([[4.0, 3.0]]))


class RangeOnly(AbstractSensor[Distance]):
    """A landmark's distance."""

    reads = landmarks.Reads
    measures = Distance

    def observe(self, state):
        return Distance(Landmarks(target=MAP).for_target(0).observe(state).range)

    def noise_std(self, state):
        return Distance(0.5)


class BearingOnly(AbstractSensor[Angle]):
    """A landmark's direction."""

    reads = landmarks.Reads
    measures = Angle

    def observe(self, state):
        return Angle(Landmarks(target=MAP).for_target(0).observe(state).bearing)

    def noise_std(self, state):
        return Angle(0.02)


@pytest.mark.parametrize("filter", [ExtendedKalman(), UnscentedKalman()])
def test_half_a_nonlinear_reading(filter, key):
    belief = Gaussian(unicycle.State(jnp.zeros(2), jnp.array(3.0)), 0.1 * jnp.eye(3))
    cases = [
        (Sight(jnp.array(5.3), jnp.array(jnp.nan)), RangeOnly(), Distance(jnp.array(5.3))),
        (Sight(jnp.array(jnp.nan), jnp.array(-2.3)), BearingOnly(), Angle(jnp.array(-2.3))),
    ]

    @quick_jit
    def both(belief):
        found = []
        for partly, sensor, value in cases:
            reading = Readings(partly, jnp.asarray(0))
            model, measurement = bind_reading(
                Installation("camera", Landmarks(target=MAP)), reading
            )
            found.append(
                (
                    filter.update(model, belief, measurement, key)[0],
                    filter.update(sensor, belief, value, key)[0],
                )
            )
        return found

    for one, other in both(belief):
        for a, b in zip(*map(jax.tree.leaves, (one, other)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


class Still(AbstractVehicle[constant_velocity.State, tuple, constant_velocity.Noise]):
    """Stays as it is, for certain."""

    def step(self, state, control, noise, dt):
        return state._replace(velocity=state.velocity + noise.acceleration * dt)

    def noise_density(self):
        return constant_velocity.Noise(jnp.zeros(2))

    def start(self):
        return BELIEF.mean

    def nominal_control(self, time):
        return ()


@pytest.mark.parametrize("name", filters.names())
def test_a_step_with_nothing_is_nothing(name, key):
    """Q = 0, F = I and no reading."""
    filter = filters.make(name)

    @quick_jit
    def idle(key):
        belief = filter.init(BELIEF, key)
        return belief.moments(), filter.predict(Still(), belief, (), 0.1, key).moments()

    for a, b in zip(*map(jax.tree.leaves, idle(key)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-15)

"""The contracts themselves: what an author writes, and what is derived from it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.contracts import (
    AbstractFilter,
    AbstractOdeVehicle,
    AbstractSensor,
    AbstractVehicle,
)
from kedge.core.quantities import Bearing, Position, Range, Ratio
from kedge.sensors.landmarks import Landmarks
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import State


@pytest.mark.parametrize(
    "cls", [AbstractVehicle, AbstractOdeVehicle, AbstractSensor, AbstractFilter]
)
def test_a_contract_cannot_be_made(cls):
    with pytest.raises(TypeError, match="abstract"):
        cls()


class Place(NamedTuple):
    position: Position


class Gauge(NamedTuple):
    east: Range


class Reads(NamedTuple):
    position: Position
    scale: Ratio = 2.0


class East(AbstractSensor[Gauge]):
    """Metres east, by a worn tape."""

    reads = Reads
    measures = Gauge

    def observe(self, state):
        assert not hasattr(state, "heading"), "it is shown what it reads and nothing else"
        return Gauge(state.scale * state.position[0])

    def noise_std(self, state):
        return Gauge(0.1 * state.scale)


class Scaled(NamedTuple):
    position: Position
    scale: Ratio


def test_a_sensor_is_shown_the_fields_it_reads():
    state = State(jnp.array([3.0, 4.0]), jnp.array(1.0))
    assert East().expect(state).east == 6
    np.testing.assert_allclose(East().noise_cov(state), [[0.04]])
    assert East().dof() == 1


def test_an_optional_field_is_read_where_the_state_has_it():
    assert East().expect(Scaled(jnp.array([3.0, 4.0]), jnp.array(5.0))).east == 15


def test_a_sensor_faces_one_target_of_its_map():
    sensor = Landmarks()
    for index in range(3):
        np.testing.assert_array_equal(
            sensor.for_target(index).target.position, sensor.target.position[index]
        )
    # The index may be traced while the map is still a plain array.
    traced = quick_jit(lambda index: sensor.for_target(index).target.position)
    np.testing.assert_array_equal(traced(2), sensor.target.position[2])


def test_a_sensor_without_a_map_is_itself():
    sensor = East()
    assert sensor.for_target(0) is sensor


class Angle(NamedTuple):
    angle: Bearing


class Pendulum(AbstractOdeVehicle[Angle, NamedTuple, Place]):
    """Turns at a rate that grows with the angle: x' = x."""

    def rates(self, state, control, noise):
        return Angle(state.angle)

    def noise_density(self):
        return Place(jnp.zeros(2))

    def start(self):
        return Angle(jnp.array(0.1))

    def nominal_control(self, time):
        return Place(jnp.zeros(2))


def test_the_runge_kutta_step_is_of_fourth_order():
    """Halving the step divides the error of x' = x after 1 s by 16."""
    step = quick_jit(lambda angle, dt: Pendulum().step(Angle(angle), None, None, dt).angle)
    errors = []
    for count in (4, 8):
        angle = jnp.array(0.1)
        for _ in range(count):
            angle = step(angle, 1 / count)
        errors.append(abs(angle - 0.1 * np.e))
    np.testing.assert_allclose(errors[0] / errors[1], 16, rtol=0.15)

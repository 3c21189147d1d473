"""The checks refuse what breaks a law, and say which: no check that cannot fail."""

from typing import Annotated, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from kedge.core.contracts import AbstractOdeVehicle, AbstractSensor, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import space_of
from kedge.core.quantities import (
    Bearing,
    Heading,
    Position,
    Range,
    Speed,
    SteeringAngle,
    Within,
    YawRate,
)
from kedge.core.registry import vehicles
from kedge.core.rotations import direction
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.testing import check_filter, check_sensor, check_vehicle
from kedge.testing.spaces import states_about


class State(NamedTuple):
    position: Range
    speed: Speed


class Push(NamedTuple):
    speed: Speed


class Rail(AbstractVehicle[State, Push, Push]):
    """A trolley that can be broken in one way at a time.

    Source: these tests.
    """

    fault: str = eqx.field(static=True, default="")

    def step(self, state, control, noise, dt):
        kick = {"noise": noise.speed, "decay": noise.speed * dt**2}
        change = control.speed * dt + kick.get(self.fault, noise.speed * dt)
        travel = (state.speed + change / 2) * dt
        if self.fault == "euler":
            travel = state.speed * dt
        if self.fault == "offset":
            travel = travel + 1e-6
        if self.fault == "rest":
            travel = travel + 1e-9 * jnp.sqrt((control.speed + noise.speed) ** 2) * dt
        if self.fault == "slope":
            travel = jax.lax.stop_gradient(travel)
        if self.fault == "drive":
            travel = travel * jnp.where(state.position > 100, jnp.inf, 1.0)
        speed = state.speed + change
        if self.fault == "shape":
            speed = speed[None]
        if self.fault == "dtype":
            speed = speed.astype(jnp.float32)
        if self.fault == "raise":
            raise ValueError("out of order")
        return State(state.position + travel, speed)

    def noise_density(self):
        return Push(jnp.array(-0.1 if self.fault == "density" else 0.1))

    def start(self):
        return State(jnp.array(0.0), jnp.zeros(2) if self.fault == "start" else jnp.array(1.0))

    def nominal_control(self, time):
        return Push(1.0 + 0.0 * time)


VEHICLE = {
    "offset": "a step of 0 s changes nothing",
    "euler": "two half steps are one step to third order",
    "noise": "noise has one variance however time is cut",
    "decay": "noise has one variance however time is cut",
    "rest": "the Jacobians are finite, also at rest",
    "slope": "the Jacobians are those of central differences",
    "drive": r"what nominal_control\(\) does stays finite for 60 s",
    "shape": "step keeps the structure, the shapes and the dtypes",
    "dtype": "step keeps the structure, the shapes and the dtypes",
    "raise": "step can be traced.*found ValueError: out of order",
    "density": "noise densities are finite and not negative",
    "start": r"start\(\) has the shapes of its quantities",
}


def test_a_sound_vehicle_passes():
    check_vehicle(Rail())


# Each compiles a program of its own; the laws that are easiest to get wrong are always tried.
LONG = (
    "offset",
    "decay",
    "rest",
    "drive",
    "slope",
    "jump",
    "noise",
    "cov",
    "skew",
    "negative",
    "nan",
)


def faults(found):
    return [pytest.param(f, marks=pytest.mark.slow) if f in LONG else f for f in found]


@pytest.mark.parametrize("fault", faults(VEHICLE))
def test_vehicle_that_breaks_a_law(fault):
    with pytest.raises(ContractError, match=f"vehicle Rail breaks the law '.*{VEHICLE[fault]}"):
        check_vehicle(Rail(fault))


class Unsourced(Rail):
    """Says nothing about where its formulas come from."""


class Needy(Rail):
    """Source: these tests."""

    length: float

    def __init__(self, length):
        self.length, self.fault = length, ""


class Uncharted(NamedTuple):
    position: Range
    mood: float


class Moody(Rail):
    """Source: these tests."""

    def start(self):
        return Uncharted(jnp.array(0.0), 0.0)


@pytest.mark.parametrize(
    ("cls", "law"),
    [
        (Unsourced, "its docstring has a Source"),
        (Needy, "it can be made without arguments"),
        (Moody, "mood has no chart"),
        (AbstractVehicle, "its docstring has a Source"),
        (ExtendedKalman, "it is an AbstractVehicle"),
    ],
)
def test_vehicle_that_cannot_be_one(cls, law):
    with pytest.raises(ContractError, match=law):
        check_vehicle(cls)


def test_a_registered_name_is_named(monkeypatch):
    assert "dull" not in vehicles.names()
    monkeypatch.setitem(vehicles._members, "dull", Unsourced)
    with pytest.raises(ContractError, match=r"vehicle 'dull' \(Unsourced\) breaks the law"):
        check_vehicle("dull")


class Reads(NamedTuple):
    heading: Heading


class Angle(NamedTuple):
    angle: Bearing


class Angles(NamedTuple):
    angle: Bearing
    other: Bearing


class Compass(AbstractSensor[Angle]):
    """A compass that can be broken in one way at a time.

    Source: these tests.
    """

    reads = Reads
    measures = Angle
    fault: str = eqx.field(static=True, default="")

    def observe(self, state):
        if self.fault == "type":
            return Angles(state.heading, state.heading)
        if self.fault == "shape":
            return Angle(state.heading[None])
        if self.fault == "turn":
            return Angle(0.7 * state.heading)
        if self.fault == "jump":
            return Angle(jnp.sqrt(jnp.abs(state.heading) * 0))
        if self.fault == "slope":
            return Angle(jax.lax.stop_gradient(state.heading))
        return Angle(state.heading)

    def noise_std(self, state):
        return Angle(jnp.array(0.0 if self.fault == "noise" else 0.1))

    def noise_cov(self, state):
        return jnp.array([[-1.0]]) if self.fault == "cov" else super().noise_cov(state)

    def dof(self):
        return 2 if self.fault == "dof" else 1


SENSOR = {
    "type": "observe returns what measures says",
    "shape": "observe returns what measures says",
    "noise": "the noise is positive",
    "cov": "noise_cov is positive definite",
    "dof": "dof is the size of the measurement",
    "turn": "a turn of the state by 360 degrees changes no measurement",
    "jump": "the Jacobian is finite",
    "slope": "the Jacobian is that of central differences",
}


def test_a_sound_sensor_passes():
    check_sensor(Compass())


@pytest.mark.parametrize("fault", faults(SENSOR))
def test_sensor_that_breaks_a_law(fault):
    with pytest.raises(
        ContractError, match=f"sensor Compass breaks the law '.*{SENSOR[fault]}"
    ):
        check_sensor(Compass(fault))


class Optional(NamedTuple):
    heading: Heading
    bias: Bearing = (0.0, 0.0)


class Shapeless(Compass):
    """Source: these tests."""

    reads = Optional


class Listless(Compass):
    """Source: these tests."""

    reads = ["heading"]


@pytest.mark.parametrize(
    ("cls", "law"),
    [
        (Shapeless, "default of the optional field 'bias' has the shape of its quantity"),
        (Listless, "reads is a NamedTuple class of quantities"),
    ],
)
def test_sensor_that_cannot_be_one(cls, law):
    with pytest.raises(ContractError, match=law):
        check_sensor(cls)


class Skewed(ExtendedKalman):
    """A filter that can be broken in one way at a time.

    Source: these tests.
    """

    fault: str = eqx.field(static=True, default="")

    def transition(self, vehicle, belief, control, dt):
        if self.fault == "refuse":
            raise ContractError("not on a Sunday")
        after, cross = super().transition(vehicle, belief, control, dt)
        spoil = {
            "skew": lambda cov: cov.at[0, 1].add(1e-3),
            "negative": lambda cov: cov - 0.2 * jnp.eye(3),
            "nan": lambda cov: cov * jnp.where(cov[0, 0] > 0.15, jnp.nan, 1.0),
        }
        return after._replace(cov=spoil[self.fault](after.cov)), cross


FILTER = {
    "refuse": "refuses every vehicle: not on a Sunday",
    "skew": "breaks the law 'covariances are symmetric'",
    "negative": "breaks the law 'predictions are finite and have no negative variance'",
    "nan": "breaks the law 'predictions are finite and have no negative variance'",
}


@pytest.mark.parametrize("fault", faults(FILTER))
def test_filter_that_breaks_a_law(fault):
    with pytest.raises(ContractError, match=f"filter Skewed.*{FILTER[fault]}"):
        check_filter(Skewed(fault))


class Steering(NamedTuple):
    rate: YawRate
    speed: Speed


class Anywhere(NamedTuple):
    position: Position
    heading: Heading
    steering_angle: SteeringAngle


class Limited(NamedTuple):
    position: Position
    heading: Heading
    steering_angle: Annotated[SteeringAngle, Within(-0.6, 0.6)]


class Bicycle(AbstractOdeVehicle):
    r"""$\dot\psi = v \tan\delta / L$, $\dot\delta = u$: correct, but not beyond a right angle.

    Source: R. Rajamani, "Vehicle Dynamics and Control", 2012, section 2.2.
    """

    limited: bool = eqx.field(static=True, default=True)

    def rates(self, state, control, noise):
        speed = control.speed + noise.speed
        turn = speed * jnp.tan(state.steering_angle) / 2.5
        rates = speed * direction(state.heading), turn, control.rate + noise.rate
        return type(state)(*rates)

    def noise_density(self):
        return Steering(jnp.array(0.01), jnp.array(0.1))

    def start(self):
        kind = Limited if self.limited else Anywhere
        return kind(jnp.zeros(2), jnp.array(0.0), jnp.array(0.0))

    def nominal_control(self, time):
        return Steering(0.1 * jnp.cos(0.5 * time), jnp.array(10.0))


def test_a_steering_angle_is_tried_within_its_range():
    check_vehicle(Bicycle())


def test_a_vehicle_that_breaks_a_law_is_told_at_which_state():
    with pytest.raises(ContractError, match=r"at the state position=.*steering_angle=.*Within"):
        check_vehicle(Bicycle(limited=False))


def test_states_are_tried_all_over_a_range_and_nowhere_else():
    states = space_of(Limited)
    base = Limited(jnp.zeros(2), jnp.array(0.0), jnp.array(0.0))
    deltas = 3 * jax.random.normal(jax.random.key(0), (200, states.size))
    points = states_about(states, base, deltas)
    assert jnp.abs(points.steering_angle).max() < 0.6
    assert points.steering_angle.std() > 0.2
    assert points.position.std() > 2

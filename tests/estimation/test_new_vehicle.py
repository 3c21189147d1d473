"""A vehicle in one file: dropped in, it is simulated, filtered and found by its name."""

import importlib.util

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.core.registry import filters, sensors, vehicles
from kedge.estimation.batch import estimate
from kedge.estimation.rig import Installation, Rig
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record
from kedge.testing import check_vehicle, quick_jit

SOURCE = '''\
"""Car towing a trailer: a second angle in the state."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractOdeVehicle
from kedge.core.quantities import Heading, Metres, Position, Scalar, Speed, SteeringAngle
from kedge.core.registry import vehicles
from kedge.core.rotations import direction


class State(NamedTuple):
    position: Position
    heading: Heading
    trailer_heading: Heading


class Control(NamedTuple):
    speed: Speed
    steering: SteeringAngle


@vehicles.add("throw-away-trailer")
class CarWithTrailer(AbstractOdeVehicle[State, Control, Control]):
    r"""Kinematic car with an on-axle hitch; position is the middle of the rear axle.

    $\\dot\\psi = (v/L)\\tan\\delta,\\quad \\dot\\psi_t = (v/D)\\sin(\\psi - \\psi_t)$

    Source: S. LaValle, "Planning Algorithms", 2006, section 13.1.2.
    """

    wheelbase: Metres = 2.7
    drawbar: Metres = 4.0
    speed_noise: float = 0.2  # m/s per sqrt(Hz)
    steering_noise: float = 0.01  # rad per sqrt(Hz)

    def rates(self, state: State, control: Control, noise: Control) -> State:
        speed = control.speed + noise.speed
        steering = control.steering + noise.steering
        hitch = state.heading - state.trailer_heading
        return State(
            position=speed * direction(state.heading),
            heading=speed / self.wheelbase * jnp.tan(steering),
            trailer_heading=speed / self.drawbar * jnp.sin(hitch),
        )

    def noise_density(self) -> Control:
        return Control(self.speed_noise, self.steering_noise)

    def start(self) -> State:
        return State(jnp.zeros(2), heading=jnp.array(0.0), trailer_heading=jnp.array(0.0))

    def nominal_control(self, time: Scalar) -> Control:
        return Control(speed=jnp.array(5.0), steering=0.1 * jnp.sin(0.3 * time))
'''


@pytest.fixture(scope="module")
def members():
    """The vehicles as they were: what is thrown away must not stay."""
    vehicles.names()
    before = dict(vehicles._members)
    yield vehicles._members
    vehicles._members.clear()
    vehicles._members.update(before)


@pytest.fixture(scope="module")
def case(members, tmp_path_factory):
    """The file on disk, imported; a rig and a recorded run of it."""
    path = tmp_path_factory.mktemp("vehicles") / "trailer.py"
    path.write_text(SOURCE)
    spec = importlib.util.spec_from_file_location("throw_away_trailer", path)
    spec.loader.exec_module(importlib.util.module_from_spec(spec))
    vehicle = vehicles.make("throw-away-trailer", drawbar=6.0)
    prior = Gaussian(vehicle.start(), 0.1 * jnp.eye(4))
    rig = Rig(vehicle, (Installation("gnss", sensors.make("gnss")),), prior)
    recording, truth = record(Scenario(rig, duration=4.0), jax.random.key(3), output_rate=1.0)
    return rig, recording, truth


def test_the_file_is_short():
    assert len(SOURCE.splitlines()) < 60


@pytest.mark.slow
def test_it_keeps_the_contract(case):
    check_vehicle("throw-away-trailer")


@pytest.mark.parametrize(
    "name",
    [
        n
        if n in ("extended", "unscented", "kalman")
        else pytest.param(n, marks=pytest.mark.slow)
        for n in filters.names()
    ],
)
def test_it_runs_with_every_filter(case, name):
    rig, recording, truth = case
    filter = filters.make(name)
    run = quick_jit(
        lambda readings: estimate(filter, rig, recording.log._replace(readings=readings))
    )
    if name == "kalman":
        with pytest.raises(ContractError, match=r"State depends nonlinearly"):
            run(recording.log.readings)
        return
    found = run(recording.log.readings)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found.moments))
    # In truth's own steps: the outputs at whole seconds, the truth every tenth of one.
    error = (
        np.asarray(found.moments.mean.position)[recording.outputs]
        - truth.fields["position"][9::10]
    )
    cov = np.asarray(found.moments.cov)[recording.outputs][:, :2, :2]
    assert np.einsum("ki,kij,kj->k", error, np.linalg.inv(cov), error).max() < 25

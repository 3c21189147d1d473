"""The piloted underwater vehicle: its routes, its loops, and what filters are told."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.estimation.rig import Rig, as_arrays
from kedge.simulation.autopilot import trim
from kedge.simulation.auv_routes import LawnMower
from kedge.simulation.scenario import History, Scenario
from kedge.simulation.simulate import simulate
from kedge.simulation.worlds.auv import TIED, Body, UnderwaterWorld
from kedge.vehicles.underwater.coefficient_files import as_coefficients
from kedge.vehicles.underwater.hydrodynamics import features, response
from kedge.vehicles.underwater.underwater import Control, Underwater


@eqx.filter_jit
def run(scenario, key):
    found = simulate(scenario, key)
    history = History(found.truth, found.controls, found.start)
    return found, scenario.world.watch(scenario, history)


def scenario_of(world, duration=60.0, dt=0.1):
    vehicle = Underwater()
    rig = Rig(vehicle, (), Gaussian(vehicle.start(), jnp.eye(12) * 1e-4))
    return as_arrays(Scenario(rig, duration, dt, world=world, feedback="truth"))


def test_the_trim_is_an_equilibrium():
    hull = as_coefficients("remus100-adjusted")
    pitch, stern = (float(value) for value in trim(hull, 1.5))
    velocity = 1.5 * jnp.array([np.cos(pitch), 0, np.sin(pitch), 0, 0, 0])
    down = jnp.array([-np.sin(pitch), 0.0, np.cos(pitch)])
    force = hull.mass() @ response(hull) @ features(velocity, down, jnp.array([0, 0, 0, stern]))
    assert pitch < -0.05  # it floats, and has to point down
    assert abs(force[2]) < 0.8  # of 7 N; small angles, and drag across the hull
    assert abs(force[4]) < 0.15


@pytest.mark.slow
def test_it_follows_a_survey_and_dives():
    world = UnderwaterWorld(
        LawnMower(leg=30.0, spacing=25.0), depths=((0.0, 2.0), (10.0, 2.0), (40.0, 8.0))
    )
    found, watched = run(scenario_of(world, 120.0), jr.key(0))
    aside, deep, turned, beyond = np.sqrt(np.mean(np.asarray(watched) ** 2, axis=0))
    assert aside < 0.4
    assert deep < 0.25
    assert turned < 0.1
    assert beyond < 0.2
    assert np.abs(found.truth.position[-1, 2] + 8.0) < 0.3


def test_lawn_mower_turns_by_half_circles():
    route = LawnMower(leg=60.0, spacing=25.0, legs=4, speed=1.5)
    middle = (60.0 + np.pi * 25 / 4) / 1.5
    place = route.at(middle)
    np.testing.assert_allclose(place.position, [72.5, 12.5], atol=1e-9)
    np.testing.assert_allclose(place.heading, np.pi / 2)
    after = route.at((60.0 + np.pi * 25 / 2) / 1.5 + 1.0)
    np.testing.assert_allclose(after.position, [58.5, 25.0], atol=1e-9)
    last = route.at(10_000.0)
    np.testing.assert_allclose(last.position[1], 75.0, atol=1e-6)


def test_a_hull_that_is_not_known_exactly():
    world, nominal = UnderwaterWorld(mismatch=0.15), as_coefficients("remus100-adjusted")
    hulls = jax.vmap(world.mistaken)(jr.split(jr.key(0), 500))
    ratios = {
        n: np.asarray(v) / nominal.values()[n] for n, v in hulls.values().items() if v.any()
    }
    assert ratios["Yvv"].min() == pytest.approx(0.85, abs=0.005)
    assert ratios["Yvv"].max() == pytest.approx(1.15, abs=0.005)
    assert abs(np.corrcoef(ratios["Yvv"], ratios["Zww"])[0, 1]) < 0.15
    for one, other in TIED.items():
        np.testing.assert_array_equal(ratios[one], ratios[other])
    for name in ("weight", "zG", "Ixx", "Xprop"):
        assert np.ptp(ratios[name]) == 0


def test_what_a_rig_estimates_is_wrong_once():
    """A scale stands for its coefficient; a moment of trim is what the nominal hull lacks."""
    world, nominal = UnderwaterWorld(mismatch=0.15), as_coefficients("remus100-adjusted")
    hull = world.mistaken(jr.key(1), ["Xuu"])
    assert hull.Xuu == nominal.Xuu
    assert hull.Yvv != nominal.Yvv

    weaker = nominal.changed(Muuds=0.9 * nominal.Muuds)
    start, none = Underwater().start(), jnp.zeros(())
    body = Body(start, jnp.zeros(3), {}, weaker, none)
    command = Control(*map(jnp.asarray, (3.86, 0.0, 0.05, -0.17)))
    lacking = (weaker.Muuds - nominal.Muuds) * start.velocity_body[0] ** 2 * -0.17
    np.testing.assert_allclose(world.unexplained(body, command), lacking, rtol=1e-9)


def test_fins_beyond_their_limit_are_counted():
    """As the root of their share of time, by which studies report whatever is watched."""
    limit = as_coefficients("remus100-adjusted").fin_limit
    scenario = scenario_of(UnderwaterWorld(), 0.4)
    steady = jax.tree.map(lambda leaf: jnp.stack([leaf] * 4), Underwater().start())
    asked = jnp.array([0.0, 2 * limit, 0.0, 0.0]), jnp.array([0.0, 0.0, 0.0, -limit])
    controls = Control(jnp.ones(4), jnp.zeros(4), *asked)
    history = History(steady, controls, Underwater().start())
    watched = eqx.filter_jit(lambda s, h: s.world.watch(s, h))(scenario, history)
    np.testing.assert_array_equal(watched[:, 3], [0.0, 1.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"depths": ()}, "depths is"),
        ({"depths": ((5.0, 1.0), (0.0, 2.0))}, "ascending"),
        ({"current": (0.1, 0.2)}, "expected 3 components"),
        ({"mismatch": 1.5}, "mismatch is 1.5"),
    ],
)
def test_worlds_that_cannot_be(given, said):
    with pytest.raises(ContractError, match=said):
        UnderwaterWorld(**given)


def test_a_step_that_is_too_long_is_refused():
    with pytest.raises(ContractError, match=r"dt is 1 s, expected at most 0.57\d s"):
        scenario_of(UnderwaterWorld(), dt=1.0)

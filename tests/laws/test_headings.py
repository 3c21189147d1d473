"""Directions have no beginning (law 8): the world may be turned, moved, and wound up."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.rotations import wrap
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.unscented import UnscentedKalman
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.sensors.landmarks import Landmark, Landmarks, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import Control, State, Unicycle

FILTERS = {
    "extended": ExtendedKalman(),
    "unscented": UnscentedKalman(),
    # A centre weight of about -1e6: FilterPy's mean of angles jumps at the seam.
    "unscented, negative": UnscentedKalman(alpha=1e-3, beta=2.0, kappa=0.0),
    "ensemble": EnsembleKalman(count=20),
    "particle": BootstrapParticle(count=20),
}
# So wide that sigma points and members lie on both sides of any seam.
ROOT = np.array([[0.5, 0.0, 0.0], [0.1, 0.4, 0.0], [0.2, -0.1, 0.6]])
HALF = np.array([0.0, np.pi, -np.pi])
TURNS = np.array([0.0, 1.0, np.pi / 2, np.pi - 1e-6, np.pi, -np.pi + 0.3, -3.0])


def rotation(angle):
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.array([[cos, -sin], [sin, cos]])


def cycle(filter, key):
    """One prediction and one update in a world that is turned, moved and wound up."""

    def run(turn, shift, windings):
        spin = rotation(turn)
        whole = jnp.eye(3).at[:2, :2].set(spin)
        heading = 0.2 + turn + 2 * jnp.pi * windings
        prior = Gaussian(
            State(spin @ jnp.array([1.0, -0.5]) + shift, heading),
            whole @ ROOT @ ROOT.T @ whole.T,
        )
        place = spin @ jnp.array([5.0, 4.0]) + shift
        sensor = Landmarks(target=Landmark(place[None])).for_target(0)
        belief = filter.init(prior, key)
        belief = filter.predict(Unicycle(speed_noise=0.5), belief, Control(1.5, 0.8), 0.5, key)
        seen = Measurement(jnp.array(4.6), 0.4 + 2 * jnp.pi * windings)
        after, score = filter.update(sensor, belief, seen, key)
        moments = after.moments()
        back = whole.T @ moments.cov @ whole
        position = spin.T @ (moments.mean.position - shift)
        # Each turned back, and the heading's difference from the first world's as an angle.
        return (
            position,
            wrap(moments.mean.heading - turn),
            back,
            score.nis,
            score.log_likelihood,
        )

    return run


@pytest.mark.parametrize(
    "name", [n if n != "particle" else pytest.param(n, marks=pytest.mark.slow) for n in FILTERS]
)
def test_the_world_may_be_wound_up(name, key):
    """Adding 2 pi k to headings and bearings changes nothing."""
    run = quick_jit(jax.vmap(cycle(FILTERS[name], key), (None, None, 0)))
    found = run(0.0, np.zeros(2), np.array([0.0, 1.0, -3.0]))
    exact = 1e-12 if "negative" not in name else 1e-8
    for part in found:
        for other in part[1:]:
            np.testing.assert_allclose(other, part[0], rtol=exact, atol=exact)


@pytest.mark.parametrize("name", ["extended", "unscented", "unscented, negative"])
def test_the_world_may_be_turned_and_moved(name, key):
    """Rigid motion of world, prior and landmark moves the estimate along; nothing else.

    Sigma points lie along the columns of a triangular root, which turn with the world by half
    a turn only. That is enough to bring the heading from far off the seam right onto it.
    """
    turns = TURNS if name == "extended" else HALF
    run = quick_jit(jax.vmap(cycle(FILTERS[name], key), (0, None, None)))
    found = run(turns, np.array([3.0, -7.0]), 0.0)
    exact = 1e-10 if "negative" not in name else 1e-7
    for part in found:
        for other in part[1:]:
            np.testing.assert_allclose(other, part[0], rtol=exact, atol=exact)

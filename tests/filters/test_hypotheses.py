"""A start of which the heading is not known, found among several."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian, Mixture
from kedge.core.errors import ContractError
from kedge.core.rotations import rotate
from kedge.filters.ensemble.stochastic import EnsembleKalman
from kedge.filters.gaussian.dead_reckoning import DeadReckoning
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.wrappers.hypotheses import Hypotheses
from kedge.filters.wrappers.robust import Robust
from kedge.sensors.gnss import Gnss, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.strapdown import Strapdown
from kedge.vehicles.unicycle import Control, State, Unicycle

NONE = jnp.zeros(2, jnp.uint32)


def test_the_starts_stand_around_the_circle():
    prior = Gaussian(State(jnp.ones(2), jnp.array(0.5)), jnp.diag(jnp.array([4.0, 9.0, 100.0])))
    belief = Hypotheses(count=4).init(prior, NONE)
    found = np.sort(np.asarray(belief.components.mean.heading))
    np.testing.assert_allclose(
        found, np.sort([0.5, 0.5 + np.pi / 2, 0.5 - np.pi, 0.5 - np.pi / 2])
    )
    np.testing.assert_allclose(np.exp(belief.log_weights), 0.25)
    np.testing.assert_allclose(belief.components.mean.position, 1.0)
    # All headings are as likely, so the mixture knows none; where it is, it knows as before.
    moments = belief.moments()
    assert moments.cov[2, 2] > 1.5
    np.testing.assert_allclose(jnp.diag(moments.cov)[:2], [4.0, 9.0])


def test_a_heading_that_the_prior_knows_is_kept():
    """At .05 rad all of the prior's moments are; and a wide one has the circle's density."""
    cov = jnp.array([[4.0, 0.0, 0.01], [0.0, 9.0, 0.02], [0.01, 0.02, 0.0025]])
    prior = Gaussian(State(jnp.ones(2), jnp.array(0.5)), cov)
    moments = Hypotheses(count=8, doubt=0.0).init(prior, NONE).moments()
    np.testing.assert_allclose(moments.mean.heading, 0.5)
    np.testing.assert_allclose(moments.cov, cov, atol=1e-9)
    for variance in (0.8, 3.9, 4.1):
        wide = prior._replace(cov=jnp.diag(jnp.array([4.0, 9.0, variance])))
        weights = np.exp(Hypotheses(count=8, doubt=0.0).init(wide, NONE).log_weights)
        # The mean resultant length of a wrapped normal is exp(-variance / 2).
        resultant = (weights * np.exp(2j * np.pi * np.arange(8) / 8)).sum()
        np.testing.assert_allclose(resultant, np.exp(-variance / 2), rtol=1e-3)
    # In doubt it faces where the prior does, and says that it may be otherwise.
    doubtful = Hypotheses(count=8).init(prior, NONE)
    np.testing.assert_allclose(np.exp(doubtful.log_weights), [0.9125] + 7 * [0.0125])
    # The hypothesis that faces back counts to one side: 0.0125 pi.
    np.testing.assert_allclose(doubtful.moments().mean.heading, 0.5, atol=0.04)


def test_doubt_is_a_probability():
    with pytest.raises(ContractError, match=r"doubt is 1\.5, must be from 0 to 1"):
        Hypotheses(doubt=1.5)


def test_an_attitude_is_turned_about_the_vertical():
    start = Strapdown().start()
    belief = Hypotheses(count=4).init(Gaussian(start, 0.01 * jnp.eye(9)), NONE)
    ahead = [rotate(q, jnp.array([1.0, 0.0, 0.0])) for q in belief.components.mean.attitude]
    np.testing.assert_allclose(
        ahead, [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], atol=1e-12
    )


@pytest.mark.parametrize(("std", "fixes"), [(1.0, 5), (0.05, 20)])
def test_fixes_on_the_way_tell_the_heading(std, fixes):
    """It drives north, having been told east; one fix on the way is an outlier.

    From a prior that is sure of the wrong heading it takes longer.
    """
    filter = Robust(Hypotheses(ExtendedKalman()))
    vehicle, sensor = Unicycle(speed_noise=0.05), Gnss(std=0.3)
    cov = jnp.diag(jnp.array([0.01, 0.01, std**2]))
    prior = Gaussian(State(jnp.zeros(2), jnp.array(0.0)), cov)

    @quick_jit
    def step(belief, fix):
        moved = filter.predict(vehicle, belief, Control(2.0, 0.0), 1.0, NONE)
        return filter.update(sensor, moved, Measurement(fix), NONE)[0]

    belief = filter.init(prior, NONE)
    for second in range(1, fixes + 1):
        place = [0.0, 2.0 * second] if second != 3 else [30.0, -30.0]
        belief = step(belief, jnp.array(place))
    heading = belief.components.mean.heading[jnp.argmax(belief.log_weights)]
    assert abs(heading - np.pi / 2) < 0.3
    np.testing.assert_allclose(jnp.exp(belief.log_weights).sum(), 1.0)
    assert np.isfinite(belief.moments().cov).all()


def test_who_is_lost_may_face_anywhere_again():
    """Hypotheses that have become one stand around the circle anew, where it was, but wider."""
    bank = Hypotheses(count=4)
    start = State(jnp.array([3.0, -2.0]), jnp.array(0.5))
    one = Gaussian(start, jnp.diag(jnp.array([0.04, 0.09, 0.01])))
    copies = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 4), one)
    belief = Mixture(copies, jnp.log(jnp.array([0.97, 0.01, 0.01, 0.01])))
    anew = bank.reset(belief, 100.0)
    ahead = jnp.exp(1j * anew.components.mean.heading)
    np.testing.assert_allclose(ahead.sum(), 0.0, atol=1e-12)
    np.testing.assert_allclose(jnp.exp(anew.log_weights), 0.25)
    np.testing.assert_allclose(anew.moments().mean.position, [3.0, -2.0])
    np.testing.assert_allclose(jnp.diag(anew.moments().cov)[:2], [4.0, 9.0])
    # Also inside a filter around it.
    inside = Robust(bank).reset(belief, 100.0)
    np.testing.assert_allclose(inside.components.mean.heading, anew.components.mean.heading)


def test_what_it_refuses():
    with pytest.raises(ContractError, match="count is 1, must be at least 2"):
        Hypotheses(count=1)
    with pytest.raises(ContractError, match="EnsembleKalman, which carries no Gaussian"):
        Hypotheses(EnsembleKalman())
    assert Hypotheses(DeadReckoning()).count == 8

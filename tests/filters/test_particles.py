"""Particle filters against closed forms and against integrals on a grid."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
import scipy

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.quantities import Acceleration, Range, Speed
from kedge.core.registry import filters
from kedge.filters.particle.auxiliary import AuxiliaryParticle
from kedge.filters.particle.bootstrap import BootstrapParticle
from kedge.filters.particle.guided import GuidedParticle
from kedge.numerics.kernels import bandwidth
from kedge.sensors.gnss import Gnss
from kedge.sensors.gnss import Measurement as Fix
from kedge.sensors.landmarks import Landmark, Landmarks, Measurement
from kedge.testing import quick_jit
from kedge.vehicles.unicycle import Control, State, Unicycle

FAMILY = [BootstrapParticle, GuidedParticle, AuxiliaryParticle]


class Trolley(NamedTuple):
    position: Range
    speed: Speed


class Push(NamedTuple):
    acceleration: Acceleration


class Rail(AbstractVehicle[Trolley, tuple, Push]):
    """Two states, one noise: the covariance of a step is singular."""

    density: float = 0.7

    def step(self, state, control, noise, dt):
        push = noise.acceleration * dt
        return Trolley(state.position + (state.speed + push / 2) * dt, state.speed + push)

    def noise_density(self):
        return Push(self.density)

    def start(self):
        return Trolley(jnp.array(0.5), jnp.array(-0.2))

    def nominal_control(self, time):
        return ()


class Seen(NamedTuple):
    range: Range


class Reads(NamedTuple):
    position: Range


class Rule(AbstractSensor[Seen]):
    """Reads the position."""

    std: float = 0.05
    reads = Reads
    measures = Seen

    def observe(self, state):
        return Seen(state.position)

    def noise_std(self, state):
        return Seen(self.std)


PRIOR = Gaussian(Rail().start(), jnp.array([[0.3, 0.1], [0.1, 0.5]]))
DT = 0.8
F = np.array([[1, DT], [0, 1]])
G = np.array([DT**2 / 2, DT]) * 0.7 / np.sqrt(DT)


@pytest.mark.parametrize("proposal", ["extended", "unscented"])
def test_on_a_linear_model_the_weight_tells_nothing_of_the_draw(proposal, key):
    """The proposal is then the optimal one, whose weight is p(z | state before the step)."""
    filter = GuidedParticle(count=30, threshold=0.0, proposal=proposal)

    @quick_jit
    def run(key):
        a, b, c = jr.split(key, 3)
        before = filter.predict(Rail(), filter.init(PRIOR, a), (), 0.3, b)
        belief = filter.predict(Rail(), before, (), DT, c)
        return before, *filter.update(Rule(), belief, Seen(jnp.array(2.0)), a)

    before, after, score = run(key)
    start = np.stack(before.states, axis=1)
    density = scipy.stats.norm((F @ start.T)[0], np.sqrt(G[0] ** 2 + 0.05**2)).pdf(2.0)
    np.testing.assert_allclose(np.exp(after.log_weights), density / density.sum(), rtol=1e-9)
    np.testing.assert_allclose(score.log_likelihood, np.log(density.mean()), rtol=1e-9)
    # The states stay where the step can have brought them: on a line for each start.
    moved = np.stack(after.states, axis=1) - start @ F.T
    np.testing.assert_allclose(moved[:, 0] * G[1], moved[:, 1] * G[0], atol=1e-12)
    # And as close to the reading as the optimal proposal puts them.
    gain = G[0] ** 2 / (G[0] ** 2 + 0.05**2)
    white = (after.states.position - 2.0) - (1 - gain) * ((F @ start.T)[0] - 2.0)
    assert 0.6 < np.std(white) / (G[0] * np.sqrt(1 - gain)) < 1.5


START = State(jnp.array([1.0, -0.5]), jnp.array(2.9))
LANDMARK = np.array([-3.0, 1.5])
CAMERA = Landmarks(
    range_std=0.05, bearing_std=0.05, target=Landmark(jnp.asarray(LANDMARK)[None])
)
ROBOT = Unicycle(speed_noise=0.5, yaw_rate_noise=0.4)
SIGHT = Measurement(jnp.array(2.6), jnp.array(-0.5))
LENGTH = 0.7


def on_a_grid():
    """Posterior mean and likelihood of the reading by a sum over both noises.

    The start is known exactly, so the posterior lives on the image of the two noises: a curved
    surface of lower dimension than the state.
    """
    axis = np.linspace(-5.5, 5.5, 401)
    speed, rate = np.meshgrid(axis, axis, indexing="ij")
    weight = np.exp(-(speed**2 + rate**2) / 2) / (2 * np.pi) * (axis[1] - axis[0]) ** 2
    distance = (1.5 + 0.5 * speed / np.sqrt(LENGTH)) * LENGTH
    turn = (0.8 + 0.4 * rate / np.sqrt(LENGTH)) * LENGTH
    chord = distance * np.sinc(turn / 2 / np.pi)
    heading = 2.9 + turn
    east = 1.0 + chord * np.cos(2.9 + turn / 2)
    north = -0.5 + chord * np.sin(2.9 + turn / 2)
    away = np.hypot(LANDMARK[0] - east, LANDMARK[1] - north)
    bearing = np.arctan2(LANDMARK[1] - north, LANDMARK[0] - east) - heading
    off = (bearing + 0.5 + np.pi) % (2 * np.pi) - np.pi
    density = scipy.stats.norm(0, 0.05).pdf(away - 2.6) * scipy.stats.norm(0, 0.05).pdf(off)
    joint = weight * density
    evidence = joint.sum()
    turned = np.array([(joint * part).sum() for part in (east, north, turn)]) / evidence
    return turned, np.log(evidence)


@pytest.mark.parametrize(
    "filter",
    [
        GuidedParticle(count=20_000, iterations=2),
        GuidedParticle(count=20_000, iterations=2, proposal="unscented"),
        AuxiliaryParticle(count=20_000, threshold=1.0),
        pytest.param(GuidedParticle(count=20_000), marks=pytest.mark.slow),
        pytest.param(BootstrapParticle(count=20_000), marks=pytest.mark.slow),
    ],
    ids=["extended", "unscented", "auxiliary", "one", "bootstrap"],
)
def test_a_nonlinear_step_on_a_manifold(filter, key):
    exact, evidence = on_a_grid()

    @quick_jit
    def run(key):
        a, b, c = jr.split(key, 3)
        belief = filter.init(Gaussian(START, jnp.zeros((3, 3))), a)
        belief = filter.predict(ROBOT, belief, Control(1.5, 0.8), LENGTH, b)
        after, score = filter.update(CAMERA.for_target(0), belief, SIGHT, c)
        return after.moments(), score

    moments, score = run(key)
    error = np.sqrt(np.diag(moments.cov) / score.effective_size)
    turned = (moments.mean.heading - 2.9 + np.pi) % (2 * np.pi) - np.pi
    found = np.array([*moments.mean.position, turned])
    # Self-normalised sums: 4.5 standard errors, and their bias of order 1 / N.
    assert (np.abs(found - exact) < 4.5 * error + 1e-4).all()
    spread = np.sqrt(1 / score.effective_size - 1 / 20_000)
    assert abs(score.log_likelihood - evidence) < 4.5 * spread + 1e-3
    if getattr(filter, "iterations", 1) == 2:
        assert score.effective_size > 19_000  # of one iteration 1,400, of the bootstrap 14


def test_a_reading_that_follows_another_redraws_nothing(key):
    """Two readings at one time weigh the same particles as one reading of both."""
    for filter in (
        GuidedParticle(count=25, threshold=0.0),
        AuxiliaryParticle(count=25, threshold=0.0),
    ):

        @quick_jit
        def run(key, filter=filter):
            a, b = jr.split(key)
            belief = filter.predict(Rail(), filter.init(PRIOR, a), (), DT, b)
            once, _ = filter.update(Rule(), belief, Seen(jnp.array(1.0)), a)
            return once, filter.update(Rule(), once, Seen(jnp.array(1.1)), b)[0]

        once, twice = run(key)
        np.testing.assert_array_equal(once.states.position, twice.states.position)
        density = scipy.stats.norm(1.1, 0.05).logpdf(once.states.position)
        shifted = np.asarray(once.log_weights) + density
        np.testing.assert_allclose(
            twice.log_weights, shifted - scipy.special.logsumexp(shifted), rtol=1e-8, atol=1e-8
        )


@pytest.mark.parametrize("make", FAMILY)
def test_a_reading_that_nothing_explains_is_a_status(make, key):
    filter = make(count=20)

    @quick_jit
    def run(key):
        belief = filter.init(PRIOR, key)
        belief = filter.predict(Rail(), belief, (), DT, key)
        return belief, *filter.update(Rule(), belief, Seen(jnp.array(1e200)), key)

    before, after, score = run(key)
    assert not score.accepted
    assert score.effective_size == 0
    assert not score.resampled
    for one, other in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("scheme", ["systematic", "multinomial"])
def test_health_is_reported(scheme, key):
    filter = BootstrapParticle(count=50, resampling=scheme)

    @quick_jit
    def run(std):
        return filter.update(Rule(std=std), filter.init(PRIOR, key), Seen(jnp.array(0.5)), key)

    (_, wide), (after, sharp) = run(100.0), run(0.05)
    assert wide.effective_size > 49.9
    assert not wide.resampled
    assert 1 < sharp.effective_size < 25
    assert sharp.resampled
    np.testing.assert_allclose(np.exp(after.log_weights), 1 / 50)
    assert len(np.unique(after.states.position)) < 25


def test_regularisation_tells_copies_apart(key):
    """By a kernel that adds h^2 of the cloud's covariance, along the cloud's own axes."""
    count, factor = 4000, 0.8

    @quick_jit
    def run(factor):
        filter = BootstrapParticle(count=count, regularisation=factor)
        belief = filter.init(PRIOR, key)
        return filter.update(Rule(std=0.2), belief, Seen(jnp.array(0.9)), key)[0]

    plain, smooth = run(0.0), run(factor)
    assert len(np.unique(plain.states.position)) < count / 2
    assert len(np.unique(smooth.states.position)) == count
    grown = 1 + (factor * bandwidth(2, count)) ** 2
    before, after = np.asarray(plain.moments().cov), np.asarray(smooth.moments().cov)
    units = np.sqrt(np.outer(np.diag(before), np.diag(before)))
    np.testing.assert_allclose((after - grown * before) / units, 0, atol=0.02)
    moved = (smooth.states.position - plain.states.position).std()
    spread = np.sqrt(plain.moments().cov[0, 0])
    np.testing.assert_allclose(moved, factor * bandwidth(2, count) * spread, rtol=0.05)


def test_silverman_in_one_dimension():
    """The rule of thumb: (4/3)^(1/5) N^(-1/5) = 1.06 N^(-1/5)."""
    np.testing.assert_allclose(bandwidth(1, 100), 1.0592 * 100**-0.2, rtol=1e-4)


@pytest.mark.parametrize("start", ["reading", "prior"])
def test_a_start_nobody_knows_is_found_in_the_first_reading(start, key):
    """A prior of 1 km on both axes, a fix good to 20 m, 300 particles: 1e-3 of the area."""
    filter = BootstrapParticle(count=300, start=start, oversampling=200)
    prior = Gaussian(State(jnp.zeros(2), jnp.array(0.0)), jnp.diag(jnp.array([1e6, 1e6, 1.0])))
    place = np.array([700.0, -1100.0])

    @quick_jit
    def run(key):
        keys = jr.split(key, 4)
        belief = filter.init(prior, keys[0])
        belief = filter.predict(Unicycle(), belief, Control(1.0, 0.0), 0.1, keys[1])
        first, score = filter.update(Gnss(std=20.0), belief, Fix(jnp.asarray(place)), keys[2])
        second, _ = filter.update(Gnss(std=20.0), first, Fix(jnp.asarray(place)), keys[3])
        return first, second, score

    first, second, score = run(key)
    moments = first.moments()
    off = np.abs(np.asarray(moments.mean.position) - place)
    spread = np.sqrt(np.diag(moments.cov))
    if start == "reading":
        assert (off < 15).all()
        np.testing.assert_allclose(spread[:2], 20, rtol=0.6)
        np.testing.assert_allclose(spread[2], 1.0, rtol=0.3)  # the fix says nothing of it
        assert 5 < score.effective_size <= 300
        assert not first.waiting
        # From the second reading on it weighs its own particles.
        assert np.isin(second.states.position, first.states.position).all()
    else:
        # Hardly any of its own explains the fix: the few are widened, to no feigned 20 m.
        assert score.effective_size < 3
        assert score.repairs == 1
        assert (spread[:2] > 100).all()


class Rounding(Rule):
    """Counts whole metres."""

    def observe(self, state):
        return Seen(jnp.round(state.position))


class Foreign(Rule):
    """Asks a program that JAX cannot look into."""

    def observe(self, state):
        shape = jax.ShapeDtypeStruct((), state.position.dtype)
        call = jax.pure_callback(np.sin, shape, state.position, vmap_method="expand_dims")
        return Seen(call)


@pytest.mark.parametrize("sensor", [Rounding(), Foreign()])
def test_a_proposal_without_a_derivative_is_refused(sensor, key):
    def run(filter):
        belief = filter.init(PRIOR, key)
        belief = filter.predict(Rail(), belief, (), DT, key)
        return filter.update(sensor, belief, Seen(jnp.array(1.0)), key)

    with pytest.raises(ContractError, match=r"needs a derivative.*proposal='unscented'"):
        jax.eval_shape(lambda: run(GuidedParticle(count=20)))
    jax.eval_shape(lambda: run(GuidedParticle(count=20, proposal="unscented")))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"count": 1}, "count is 1, must be at least 2"),
        ({"threshold": -0.5}, "threshold is -0.5, must be at least 0"),
        ({"regularisation": -1.0}, "regularisation is -1.0, must be at least 0"),
        ({"oversampling": 0}, "oversampling is 0, must be at least 1"),
        ({"resampling": "systemic"}, r"resampling.*did you mean 'systematic'\?"),
        ({"start": "gps"}, "start called 'gps'; there are prior, reading"),
    ],
)
@pytest.mark.parametrize("make", FAMILY)
def test_bad_parameters(make, parameters, message):
    with pytest.raises(ContractError, match=f"{filters.name_of(make)}: .*{message}"):
        make(**parameters)


def test_an_unknown_proposal():
    with pytest.raises(ContractError, match=r"proposal called 'ekf'.*extended, unscented"):
        filters.make("guided", proposal="ekf")


def test_single_precision_stays_single(key):
    half = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), (PRIOR, Rail(), Rule()))
    prior, rail, rule = half
    for make in FAMILY:

        def run(make=make):
            filter = make(count=20)
            belief = filter.init(prior, key)
            belief = filter.predict(rail, belief, (), jnp.float32(0.1), key)
            return filter.update(rule, belief, Seen(jnp.float32(0.3)), key)

        after, score = jax.eval_shape(run)
        kinds = {leaf.dtype for leaf in jax.tree.leaves((after, score.cov))}
        assert kinds == {jnp.dtype("float32")}


@pytest.mark.parametrize("filter", [BootstrapParticle(count=300), GuidedParticle(count=300)])
def test_a_cloud_in_one_place_is_widened_and_counted(filter, key):
    """A reading of a hundredth of the prior's spread: few particles are near it."""
    prior = Gaussian(State(jnp.zeros(2), jnp.array(0.0)), jnp.diag(jnp.array([1.0, 1.0, 0.1])))
    belief = filter.init(prior, key)
    sharp, vague = (
        filter.update(Gnss(std=std), belief, Fix(jnp.array([0.4, 0.2])), key)
        for std in (0.01, 1.0)
    )
    assert sharp[1].repairs == 1
    assert vague[1].repairs == 0
    cov = sharp[0].moments().cov
    assert np.linalg.eigvalsh(cov).min() > 1e-4
    assert np.abs(sharp[0].moments().mean.position - jnp.array([0.4, 0.2])).max() < 1.0

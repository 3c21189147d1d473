"""What particle filters share: drawing, weighing and resampling; they differ by proposal.

The number of particles is fixed. Choosing it by the cloud's spread (KLD sampling) needs static
shapes here, so that particles beyond the count would be computed and masked: it could save no
time, and is left out.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from kedge.core.beliefs import Gaussian, LastStep, Particles
from kedge.core.contracts import (
    AbstractFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.quantities import Scalar
from kedge.core.registry import filters, unknown
from kedge.numerics.branching import whenever
from kedge.numerics.innovation import innovation
from kedge.numerics.kernels import bandwidth, roughened, shrunk
from kedge.numerics.linalg import cholesky, square_root, symmetric
from kedge.numerics.noise import draws, process_std
from kedge.numerics.random import normals
from kedge.numerics.resampling import SCHEMES, effective_sample_size, normalised

STARTS: list[str] = ["prior", "reading"]


class Sight(NamedTuple):
    """A reading compared with every particle."""

    residual: Float[Array, "N m"]
    noise_cov: Float[Array, "N m m"]
    log_likelihood: Float[Array, " N"]


class Weighed(NamedTuple):
    """Particles after a reading; the sum of their weights is the reading's likelihood."""

    states: Any
    log_weights: Float[Array, " N"]
    resampled: Bool[Array, ""] | bool = False
    may_resample: Bool[Array, ""] | bool = True


class AbstractParticleFilter(AbstractFilter[Particles]):
    r"""``count`` weighted states; log weights throughout.

    A reading that no particle explains is refused: the belief stays, and the innovation says
    ``accepted=False`` with an effective size of 0.

    * ``resampling``: systematic, stratified, residual or multinomial, where the effective size
      falls below ``threshold`` of the count.
    * A cloud that is resampled into so few places that its covariance is singular is widened by
      a kernel of the predicted one; the innovation counts that as a repair.
    * ``regularisation``: after resampling each particle is drawn again from a Gaussian kernel,
      in the tangent space, whose standard deviation is this factor times Silverman's bandwidth
      times the cloud's. 0 leaves the copies as they are, which is unbiased; up to 1 keeps a
      cloud alive whose process noise is small.
    * ``start``: with "reading" the first reading is weighed against ``oversampling`` times as
      many candidates, drawn from the prediction as a smooth density (every particle with a
      kernel, moments kept), of which ``count`` are resampled. That is importance sampling
      from the prior: nothing is inverted, so it serves every sensor, and it finds a start in
      a prior that is wider than the reading by about count times oversampling in volume. It
      costs its candidates once, also in a batch of runs that are all found at the same time.
    """

    count: int = eqx.field(static=True, default=1000)
    threshold: Scalar = 0.5
    resampling: str = eqx.field(static=True, default="systematic")
    regularisation: Scalar = 0.0
    start: str = eqx.field(static=True, default="prior")
    oversampling: int = eqx.field(static=True, default=50)

    looks_back: ClassVar[bool] = False
    """Whether the last step is kept, to be drawn again in the light of a reading."""

    def __check_init__(self):
        name = filters.name_of(type(self))
        for field, value, least in (
            ("count", self.count, 2),
            ("oversampling", self.oversampling, 1),
            ("threshold", self.threshold, 0),
            ("regularisation", self.regularisation, 0),
        ):
            if isinstance(value, int | float) and not value >= least:
                raise ContractError(f"{name}: {field} is {value}, must be at least {least}")
        for field, word, known in (
            ("resampling", self.resampling, list(SCHEMES)),
            ("start", self.start, STARTS),
        ):
            if word not in known:
                raise ContractError(f"{name}: {unknown(field, word, known)}")

    @abc.abstractmethod
    def weigh(
        self,
        model: AbstractMeasurementModel,
        belief: Particles,
        measurement: Any,
        sight: Sight,
        key: PRNGKeyArray,
    ) -> Weighed:
        """The particles in the light of a reading; ``sight`` is that of the predicted ones."""

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Particles:
        """Draw from the prior."""
        states = space(prior.mean)
        white = normals(key, (self.count, states.size), prior.cov.dtype)
        errors = white @ square_root(prior.cov).T
        cloud = jax.vmap(states.boxplus, (None, 0))(prior.mean, errors)
        waiting = jnp.asarray(True) if self.start == "reading" else None
        return Particles(cloud, _equal(self.count, errors.dtype), waiting=waiting)

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Particles,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Particles:
        """Step every particle with its own noise."""
        noises = space(vehicle.noise_density())
        noise = draws(key, self.count, process_std(vehicle, dt))

        def step(state: Any, noise: Float[Array, " w"]) -> Any:
            return vehicle.step(state, control, noises.unflatten(noise), dt)

        last = None
        if self.looks_back:
            last = LastStep(belief.states, *_as_carried((vehicle, control, dt)))
        return belief._replace(states=jax.vmap(step, (0, 1))(belief.states, noise), last=last)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Particles,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Particles, Innovation]:
        """Weigh the particles; resample if few carry the weight."""
        weigh_key, resample_key, smear_key, seek_key = jr.split(key, 4)
        widen_key = jr.fold_in(resample_key, 1)
        sight = look(model, belief.states, measurement)

        def usual() -> tuple[Weighed, Float[Array, ""]]:
            weighed = self.weigh(model, belief, measurement, sight, weigh_key)
            weighed = weighed._replace(
                resampled=jnp.asarray(weighed.resampled),
                may_resample=jnp.asarray(weighed.may_resample),
            )
            return weighed, effective_sample_size(weighed.log_weights)

        if belief.waiting is None:
            weighed, size = usual()
        else:
            weighed, size = whenever(
                belief.waiting,
                lambda: self._seek(model, belief, measurement, seek_key),
                usual,
            )
        log_weights, evidence = normalised(weighed.log_weights)
        explained = jnp.isfinite(evidence)

        few = (size < self.threshold * self.count) & weighed.may_resample & explained
        states, log_weights, places = lax.cond(
            few,
            lambda: self._resample(weighed.states, log_weights, resample_key),
            lambda: (weighed.states, log_weights, jnp.asarray(self.count)),
        )
        states, widened = self._widen(states, belief, places, widen_key)
        resampled = few | (weighed.resampled & explained)
        states = self._regularise(states, log_weights, resampled, smear_key)

        posterior = belief._replace(
            states=states,
            log_weights=log_weights,
            last=belief.last and belief.last.used(),
            waiting=None if belief.waiting is None else jnp.asarray(False),
        )
        kept = jax.tree.map(lambda a, b: jnp.where(explained, a, b), posterior, belief)
        score = _predicted(belief, sight, model)._replace(
            log_likelihood=evidence,
            accepted=explained,
            effective_size=jnp.minimum(size, self.count),
            resampled=resampled,
            repairs=jnp.where(widened, 1, 0),
        )
        return kept, score

    def _resample(
        self, states: Any, log_weights: Float[Array, " N"], key: PRNGKeyArray
    ) -> tuple[Any, Float[Array, " N"], Int[Array, ""]]:
        """The chosen ones, their weights, and how many different ones they are."""
        chosen = SCHEMES[self.resampling](key, log_weights)
        places = jnp.zeros(self.count, int).at[chosen].set(1).sum()
        weights = _equal(self.count, log_weights.dtype)
        return jax.tree.map(lambda leaf: leaf[chosen], states), weights, places

    def _widen(
        self, states: Any, belief: Particles, places: Int[Array, ""], key: PRNGKeyArray
    ) -> tuple[Any, Bool[Array, ""]]:
        """The cloud with the kernels of the predicted one, if it stands in too few places.

        n + 1 of them are needed to span n dimensions: of fewer the covariance is singular, and
        the cloud would be sure of what it only cannot resolve.
        """
        size = space(states).size
        collapsed = places <= min(size, self.count - 1)
        width = bandwidth(size, self.count)
        return whenever(
            collapsed,
            lambda: (roughened(key, states, belief.moments(), width), jnp.asarray(True)),
            lambda: (states, jnp.asarray(False)),
        )

    def _regularise(
        self,
        states: Any,
        log_weights: Float[Array, " N"],
        resampled: Bool[Array, ""],
        key: PRNGKeyArray,
    ) -> Any:
        if isinstance(self.regularisation, int | float) and self.regularisation == 0:
            return states
        width = self.regularisation * bandwidth(space(states).size, self.count)
        return lax.cond(
            resampled & (width > 0),
            lambda: roughened(key, states, Particles(states, log_weights).moments(), width),
            lambda: states,
        )

    def _seek(
        self,
        model: AbstractMeasurementModel,
        belief: Particles,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Weighed, Float[Array, ""]]:
        """Weigh many candidates of the predicted density, and resample as many as usual."""
        smear_key, resample_key, offset_key = jr.split(key, 3)
        cloud = belief.moments()
        width = bandwidth(space(belief.states).size, self.count)
        drawn_in = shrunk(belief.states, cloud, width)
        many = jax.tree.map(lambda leaf: jnp.repeat(leaf, self.oversampling, axis=0), drawn_in)
        many = roughened(smear_key, many, cloud, width)
        shared = belief.log_weights - jnp.log(self.oversampling)
        log_weights = jnp.repeat(shared, self.oversampling)
        log_weights += look(model, many, measurement).log_likelihood
        shares, evidence = normalised(log_weights)
        # Every so many-th of the sorted ancestors, from a random one on: still unbiased.
        chosen = SCHEMES[self.resampling](resample_key, shares)
        offset = jr.randint(offset_key, (), 0, self.oversampling)
        chosen = chosen.reshape(self.count, self.oversampling)[:, offset]
        states = jax.tree.map(lambda leaf: leaf[chosen], many)
        restarted = _equal(self.count, shares.dtype) + evidence
        done = Weighed(states, restarted, jnp.asarray(True), jnp.asarray(False))
        return done, effective_sample_size(shares)


def look(model: AbstractMeasurementModel, states: Any, measurement: Any) -> Sight:
    """Compare a reading with what every state would give."""
    outputs = space(measurement)

    def against(state: Any) -> Sight:
        residual = outputs.boxminus(measurement, model.expect(state))
        noise_cov = model.noise_cov(state)
        score = innovation(residual, noise_cov, cholesky(noise_cov), model.dof())
        return Sight(residual, noise_cov, score.log_likelihood)

    return jax.vmap(against)(states)


def _predicted(belief: Particles, sight: Sight, model: AbstractMeasurementModel) -> Innovation:
    """The innovation under the moments of the predicted particles."""
    weights = jnp.exp(normalised(belief.log_weights)[0])
    residual = weights @ sight.residual
    spread = sight.residual - residual[None]
    noise_cov = jnp.tensordot(weights, sight.noise_cov, 1)
    S = symmetric(spread.T @ (weights[:, None] * spread) + noise_cov)
    return innovation(residual, S, cholesky(S), model.dof())


def _equal(count: int, dtype: Any) -> Float[Array, " N"]:
    return jnp.full(count, -jnp.log(count), dtype)


def _as_carried(tree: Any) -> Any:
    """Numbers as arrays of the dtype that they have in a scan."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(leaf)), tree)

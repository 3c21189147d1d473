"""Interacting multiple models: several motions, and the probability of each."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian, Mixture
from kedge.core.contracts import (
    AbstractFilter,
    AbstractGaussianFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.core.registry import filters
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.numerics.innovation import mixture_innovation


class Restless(AbstractVehicle[Any, Any, Any]):
    """A vehicle whose process noise is ``factor`` times that of another."""

    vehicle: AbstractVehicle
    factor: Scalar

    def step(self, state: Any, control: Any, noise: Any, dt: Scalar) -> Any:
        """As the vehicle."""
        return self.vehicle.step(state, control, noise, dt)

    def noise_density(self) -> Any:
        """The vehicle's, multiplied."""
        density = self.vehicle.noise_density()
        return type(density)(*(jnp.asarray(value) * self.factor for value in density))

    def start(self) -> Any:
        """As the vehicle."""
        return self.vehicle.start()

    def nominal_control(self, time: Scalar) -> Any:
        """As the vehicle."""
        return self.vehicle.nominal_control(time)


@filters.add("interacting")
class InteractingModels(AbstractFilter[Mixture]):
    r"""The IMM estimator: one ``inner`` filter for each of several motions of one state.

    Before a prediction the modes are mixed, $\mu_{i|j} = p_{ij} w_i / \sum_i p_{ij} w_i$; each
    starts from the moments of the mixture that could have led to it. After an update
    $w_j \propto w_j\, p(z \mid j)$.

    The modes are the rig's vehicle and the same with ``noise`` times its process noise, which
    is for manoeuvres; or, from Python, the ``vehicles`` given, which share the state, control
    and noise types of the rig's and take its place. A mode lasts ``sojourn`` seconds on
    average and is followed by any other: a Markov chain in continuous time, so that the step's
    length does not matter, $p_{jj} = 1/M + (1 - 1/M) e^{-\Delta t M / ((M - 1) \tau)}$.

    The innovation reported is that of the mixture's moments; its likelihood is the mixture's.

    Source: H. Blom, Y. Bar-Shalom, "The interacting multiple model algorithm for systems with
    Markovian switching coefficients", IEEE Trans. Automatic Control 33(8), 1988.
    """

    inner: AbstractFilter = ExtendedKalman()
    noise: Scalar = 10.0
    sojourn: Scalar = 10.0  # s
    vehicles: tuple[AbstractVehicle, ...] | None = None

    def __check_init__(self):
        if not isinstance(self.inner, AbstractGaussianFilter):
            raise ContractError(
                f"interacting: inner is {type(self.inner).__name__}, which carries no "
                "Gaussian; expected a filter such as 'extended' or 'unscented'"
            )
        for name, value in (("noise", self.noise), ("sojourn", self.sojourn)):
            if isinstance(value, int | float) and not value > 0:
                raise ContractError(f"interacting: {name} is {value:g}, must be above 0")
        if self.vehicles is not None and len(self.vehicles) < 2:
            raise ContractError(
                f"interacting: {len(self.vehicles)} vehicles, expected at least 2"
            )

    @property
    def count(self) -> int:
        """How many modes there are."""
        return 2 if self.vehicles is None else len(self.vehicles)

    def modes(self, vehicle: AbstractVehicle) -> tuple[AbstractVehicle, ...]:
        """The motions between which it chooses, on a rig with ``vehicle``."""
        if self.vehicles is None:
            return vehicle, Restless(vehicle, self.noise)
        wanted = type(vehicle.start())
        for mode in self.vehicles:
            if type(mode.start()) is not wanted:
                raise ContractError(
                    f"interacting: the state of {type(mode).__name__} is a "
                    f"{type(mode.start()).__qualname__}, expected the rig's "
                    f"{wanted.__qualname__}"
                )
        return self.vehicles

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Mixture:
        """Every mode at the prior, all equally likely."""
        del key
        copies = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * self.count), prior)
        return Mixture(copies, jnp.full(self.count, -jnp.log(self.count)))

    def considers(self) -> bool:
        """The inner filter's."""
        return self.inner.considers()

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Mixture,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Mixture:
        """Mix, then move every mode by its own motion."""
        joint = jnp.exp(belief.log_weights)[:, None] * self._switching(dt)
        weights = jnp.sum(joint, axis=0)
        predicted = []
        for j, mode in enumerate(self.modes(vehicle)):
            start = self.inner.init(belief.merged(joint[:, j] / weights[j]), key)
            predicted.append(self.inner.predict(mode, start, control, dt, key).moments())
        components = jax.tree.map(lambda *leaves: jnp.stack(leaves), *predicted)
        return Mixture(components, jnp.log(weights))

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Mixture,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Mixture, Innovation]:
        """Update every mode; weigh it by how well it foresaw the measurement."""

        def one(component):
            start = self.inner.init(component, key)
            posterior, score = self.inner.update(model, start, measurement, key)
            return posterior.moments(), score

        posteriors, scores = jax.vmap(one)(belief.components)
        joint = belief.log_weights + scores.log_likelihood
        evidence = logsumexp(joint)

        score = mixture_innovation(belief.log_weights, scores, model.dof())
        return Mixture(posteriors, joint - evidence), score._replace(log_likelihood=evidence)

    def _switching(self, dt: Scalar) -> Float[Array, "M M"]:
        share = 1 / self.count
        stays = jnp.exp(-dt / (self.sojourn * (1 - share)))
        return share * (1 - stays) + stays * jnp.eye(self.count)

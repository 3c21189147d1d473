"""What ensemble filters share: they differ by how they move the members at an update.

Members are moved by tangent vectors at their mean, so angles and attitudes need no case of
their own; on a flat state these are the textbook anomalies.
"""

import abc
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Ensemble, Gaussian, members_wise
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
from kedge.numerics.ensemble import Evidence, Whitened, rotation, scored, whiten
from kedge.numerics.noise import correlated, draws, process_std
from kedge.numerics.random import normals, split
from kedge.numerics.spread import with_noise

NOISES = ("sampled", "deterministic")


class AbstractEnsembleFilter(AbstractFilter[Ensemble]):
    r"""Members $x_i$ that carry mean and covariance as their sample moments.

    After an update the anomalies are multiplied by ``inflation`` (the covariance by its
    square) and, with ``rotation``, turned by a random orthogonal matrix that changes neither
    mean nor covariance. What is reported is the sample covariance of the members as they are
    then.

    ``noise`` is how process noise enters: ``sampled``, each member steps with its own draw, or
    ``deterministic``, the anomalies are stretched so that their covariance grows by what the
    noise adds; see :func:`kedge.numerics.spread.with_noise`.

    ``radius`` is the distance at which the influence of a measured component on a component of
    the state ends, in the unit of the measurement model's ``distances``; infinite by default.

    Source: G. Evensen, "The ensemble Kalman filter: theoretical formulation and practical
    implementation", Ocean Dynamics 53, 2003.
    """

    count: int = eqx.field(static=True, default=100)
    inflation: Scalar = 1.0
    rotation: bool = eqx.field(static=True, default=False)
    noise: str = eqx.field(static=True, default="sampled")
    radius: float = eqx.field(static=True, default=math.inf)

    def __check_init__(self):
        name = filters.name_of(type(self))
        if self.count < 2:
            raise ContractError(f"{name}: count is {self.count}, must be at least 2")
        if isinstance(self.inflation, int | float) and not 0 < self.inflation < math.inf:
            raise ContractError(
                f"{name}: inflation is {self.inflation:g}, must be above 0 and finite; it "
                "multiplies the anomalies, 1 is none"
            )
        if self.noise not in NOISES:
            raise ContractError(f"{name}: {unknown('noise', self.noise, list(NOISES))}")
        if not self.radius > 0:
            raise ContractError(
                f"{name}: radius is {self.radius:g}, must be above 0; leave it out for none"
            )

    @abc.abstractmethod
    def analyse(
        self,
        white: Whitened,
        anomalies: Float[Array, "n N"],
        distances: Float[np.ndarray, "m n"] | None,
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, " n"], Float[Array, "n N"], Evidence]:
        r"""The shift of the mean, the new anomalies, and how the residual fits.

        The anomalies are divided by $\sqrt{N - 1}$ on either side; ``distances`` are there if
        and only if the filter has a finite radius.
        """

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Ensemble:
        """Draw the members from the prior."""
        states = space(prior.mean)
        white = normals(key, (states.size, self.count), prior.cov.dtype)
        return Ensemble.around(prior.mean, correlated(white, prior.cov))

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Ensemble,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Ensemble:
        """Step every member, with noise."""
        noises = space(vehicle.noise_density())
        std = process_std(vehicle, dt)

        def step(state, noise):
            return vehicle.step(state, control, noises.unflatten(noise), dt)

        if self.noise == "deterministic":
            return with_noise(step, belief, std, key)
        noise = draws(key, self.count, std)
        return Ensemble(members_wise(step)(belief.columns, noise))

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Ensemble,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Ensemble, Innovation]:
        """Analyse in tangent coordinates at the mean, then inflate and rotate.

        An ensemble without any spread cannot learn: the reading is refused.

        Raises:
            ContractError: the filter has a radius, and the model no distances.
        """
        distances = self._distances(model, belief)
        analyse_key, turn_key = split(key)
        mean, anomalies = belief.centred()
        expected, spread = Ensemble(members_wise(model.expect)(belief.columns)).centred()
        residual = space(measurement).boxminus(measurement, expected)

        white = whiten(model, mean, residual, spread)
        normal = (self.count - 1) ** 0.5
        shift, updated, evidence = self.analyse(
            white, anomalies / normal, distances, analyse_key
        )
        updated = updated * (normal * self.inflation)
        if self.rotation:
            updated = updated @ rotation(turn_key, self.count, updated.dtype)
        after = Ensemble.around(mean, shift[:, None] + updated)

        score = scored(residual, white, evidence, model.dof())
        return after, score._replace(accepted=jnp.any(anomalies != 0))

    def _distances(
        self, model: AbstractMeasurementModel, belief: Ensemble
    ) -> Float[np.ndarray, "m n"] | None:
        if math.isinf(self.radius):
            return None
        distances = model.distances(belief.columns)
        if distances is None:
            raise ContractError(
                f"{filters.name_of(type(self))}: radius is {self.radius:g}, but "
                f"{type(model).__name__} "
                "has no distances between what it measures and the state; give the sensor a "
                "method 'distances', or leave the radius out"
            )
        return distances

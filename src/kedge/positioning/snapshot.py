"""A filter without a memory of where it was: each epoch of ranges is solved by itself."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian, inflated_cov
from kedge.core.contracts import (
    AbstractFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
    Ranging,
)
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.quantities import Metres, Ratio, Scalar, Seconds
from kedge.core.registry import filters
from kedge.numerics.innovation import innovation
from kedge.numerics.linalg import cholesky, symmetric
from kedge.numerics.noise import process_std
from kedge.numerics.propagation import Taylor
from kedge.positioning.fix import Status
from kedge.positioning.links import Links
from kedge.positioning.solver import Solver

LONG_AGO = 1e9  # s; an infinity in a belief would read as an error


class Recent(NamedTuple):
    """The last range of each anchor that was heard; leading axis: the filter's ``links``."""

    links: Links
    age: Float[Array, " k"]  # s


class SnapshotBelief(NamedTuple):
    """What is believed, and the ranges that the next fix may use."""

    mean: Any
    cov: Float[Array, "n n"]
    recent: Recent

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian(self.mean, self.cov)

    def inflated(self, factor: Scalar) -> "SnapshotBelief":
        """The same mean, the covariance times ``factor`` but for augmented states."""
        return self._replace(cov=inflated_cov(self.mean, self.cov, factor))


@filters.add("fix")
class Snapshot(AbstractFilter[SnapshotBelief]):
    """The position as the latest ranges alone have it: the baseline of every use of ranges.

    A reading with the ranges of a whole epoch is solved at once. Where each reading is one
    range, the last of every anchor that is not older than ``window`` seconds counts, as if the
    vehicle had stood still. The fix replaces what was believed of the position; all else stays
    as predicted, and so does the position while ranges are too few. Readings that are no ranges
    are dropped. Of two mirror images it takes the one nearer to the prediction.

    ``solver`` and the parameters after it are those of
    :class:`kedge.positioning.solver.Solver`.

    Source: A. Sayed, A. Tarighat, N. Khajehnouri, "Network-based wireless location: challenges
    faced in developing techniques for accurate wireless location information", IEEE Signal
    Processing Magazine 22(4), 2005.
    """

    solver: str = eqx.field(static=True, default="ml")
    window: Seconds = 0.5
    debias: bool = eqx.field(static=True, default=True)
    reference: int = eqx.field(static=True, default=1)
    printed: bool = eqx.field(static=True, default=False)
    loss: str = eqx.field(static=True, default="l2")
    tuning: Ratio = 0.0
    excess_mean: Metres = 0.5
    excess_std: Metres = 0.5
    excess_share: Ratio = 0.2
    links: int = eqx.field(static=True, default=16)
    """From so many anchors single ranges are kept."""

    def __check_init__(self):
        self.solving()
        if self.links < 1:
            raise ContractError(f"fix: links is {self.links}, must be at least 1")

    def solving(self) -> Solver:
        """The solver with its options."""
        return Solver(
            self.solver, self.debias, self.reference, self.printed, self.loss, self.tuning,
            self.excess_mean, self.excess_std, self.excess_share,
        )  # fmt: skip

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> SnapshotBelief:
        """The prior; no range was heard yet."""
        del key
        size = jnp.shape(getattr(prior.mean, "position", jnp.zeros(2)))[-1]
        none, ones = jnp.zeros(self.links), jnp.ones(self.links)
        links = Links(jnp.zeros((self.links, size)), none, ones, none, none)
        return SnapshotBelief(prior.mean, prior.cov, Recent(links, LONG_AGO * ones))

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: SnapshotBelief,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> SnapshotBelief:
        """By the motion model, as dead reckoning does; ranges grow older."""
        del key
        states, noises = space(belief.mean), space(vehicle.noise_density())

        def step(error: Array, noise: Array) -> Any:
            state = states.boxplus(belief.mean, error)
            return vehicle.step(state, control, noises.unflatten(noise), dt)

        std = process_std(vehicle, dt).astype(belief.cov.dtype)
        moments = Taylor().propagated(step, belief.cov, std)
        recent = belief.recent._replace(age=belief.recent.age + dt)
        return SnapshotBelief(moments.mean, moments.cov, recent)

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: SnapshotBelief,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[SnapshotBelief, Innovation]:
        """Solve for the position, and put it in the place of the prediction's."""
        del key
        score = _score(model, belief, measurement)
        ranging = model.ranging(belief.mean)
        if ranging is None:
            return belief, score._replace(accepted=False)
        if not hasattr(belief.mean, "position"):
            raise ContractError("fix: the state has no position that ranges could tell")
        epoch = _epoch(model, belief.mean, ranging, measurement)
        recent = belief.recent
        if len(ranging.scale) == 1:
            recent = _heard(recent, epoch)
            fresh = recent.age <= self.window
            links = recent.links
            epoch = links._replace(ranges=jnp.where(fresh, links.ranges, jnp.nan))
        near = belief.mean.position
        fix = self.solving().solve(epoch, near)
        solved = fix.status <= Status.AMBIGUOUS
        place = space(belief.mean).slices()["position"]
        cov = belief.cov.at[place, :].set(0.0).at[:, place].set(0.0)
        cov = cov.at[place, place].set(symmetric(fix.cov))
        posterior = SnapshotBelief(
            belief.mean._replace(position=jnp.where(solved, fix.position, near)),
            jnp.where(solved, cov, belief.cov),
            recent,
        )
        return posterior, score._replace(accepted=solved)


def _epoch(
    model: AbstractMeasurementModel, mean: Any, ranging: Ranging, measurement: Any
) -> Links:
    """The ranges without scales and biases of instruments; NaN where they are missing."""
    ranges = space(measurement).flatten(measurement)
    std = jnp.sqrt(jnp.diag(model.noise_cov(mean)))
    return Links(
        ranging.anchors,
        jnp.where(ranging.present, ranges - ranging.bias, jnp.nan) / ranging.scale,
        std / ranging.scale,
        ranging.excess / ranging.scale,
        ranging.rise,
    )


def _heard(recent: Recent, epoch: Links) -> Recent:
    """The range in the place of that anchor's last, or of the oldest."""
    links = recent.links
    same = jnp.all(links.anchors == epoch.anchors, axis=1) & (recent.age < LONG_AGO)
    slot = jnp.where(same.any(), jnp.argmax(same), jnp.argmax(recent.age))
    kept = jax.tree.map(lambda all_, one: all_.at[slot].set(one[0]), links, epoch)
    return Recent(kept, recent.age.at[slot].set(0.0))


def _score(
    model: AbstractMeasurementModel, belief: SnapshotBelief, measurement: Any
) -> Innovation:
    """How the reading fits the prediction."""
    states = space(belief.mean)
    moments = Taylor().propagated(
        lambda error: model.expect(states.boxplus(belief.mean, error)), belief.cov
    )
    cov = symmetric(moments.cov + model.noise_cov(belief.mean))
    residual = space(moments.mean).boxminus(measurement, moments.mean)
    return innovation(residual, cov, cholesky(cov), model.dof())

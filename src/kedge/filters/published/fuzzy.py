"""Fuzzy Kalman filter: one linear model and one covariance for each corner of a box."""

import math
import warnings
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core.beliefs import Gaussian, Mixture
from kedge.core.contracts import (
    AbstractFilter,
    AbstractMeasurementModel,
    AbstractVehicle,
    Innovation,
)
from kedge.core.errors import ContractError
from kedge.core.manifolds import Space, space
from kedge.core.quantities import Scalar
from kedge.core.registry import filters, unknown
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.published.linearised import CHOICES, coordinates, line_at
from kedge.numerics.fuzzy import corners, memberships
from kedge.numerics.innovation import mixture_innovation

Box = tuple[tuple[str, float, float], ...]
"""A component of the state, its lower and its upper end, for each side of the box."""


def as_box(given: Mapping[str, Any] | Box | str | None) -> Box:
    """A box from a mapping, from ``velocity_x:0..1.5/velocity_y:-1..1``, or from nothing.

    Raises:
        ContractError: a side is not a name with two numbers.
    """
    if isinstance(given, str):
        return tuple(_side(side) for side in given.split("/") if given)
    try:
        if isinstance(given, Mapping):
            given = tuple((name, *ends) for name, ends in given.items())
        return tuple((str(name), float(low), float(high)) for name, low, high in given or ())
    except (TypeError, ValueError):
        raise ContractError(
            f"fuzzy: box is {given!r}, expected a mapping like {{'velocity_x': (0.0, 1.5)}}"
        ) from None


def _side(side: str) -> tuple[str, float, float]:
    name, _, ends = side.partition(":")
    low, _, high = ends.partition("..")
    try:
        return name.strip(), float(low), float(high)
    except ValueError:
        raise ContractError(
            f"fuzzy: box has the side {side!r}, expected NAME:LOWER..UPPER, like "
            "'velocity_x:0..1.5', with '/' between sides"
        ) from None


@filters.add("fuzzy")
class FuzzyKalman(AbstractFilter[Mixture]):
    r"""Takagi-Sugeno rules over a box in some components of the state.

    Rule i: if those components are at corner i of the ``box`` then the motion is the vehicle's
    linearisation there, the other components at the current estimate:
    $P_i^- = F_i P_i F_i^\top + G_i Q G_i^\top$. A rule counts
    $\rho_i = \prod_j \mu_{ij}(\hat x)$ with memberships that fall and rise linearly over each
    side. Every rule keeps its own covariance and corrects the prediction by its own gain; the
    next prediction of all starts from the one state $\sum_i \rho_i x_i$. What is reported is
    that state, with the covariance within and between the rules, and the innovation likewise.

    * ``box``: by the state's labels, ``{"velocity_x": (0.0, 1.5)}`` in Python and in rig
      files, ``box=velocity_x:0..1.5/velocity_y:0..1`` where a filter is typed. Without one
      there is one rule, at the estimate: the extended filter.
    * ``predictor``: "affine" takes each rule's line through the estimate itself,
      $x_i^- = f(\hat x, u)$ for all; "jx" is the published form without that offset,
      $x_i^- = F_i \hat x + B u$ (the input's derivative B at the estimate), which for a model
      quadratic in x counts the quadratic part twice.
    * ``covariance``: "literal" is the published $(F_i - I) P_i (F_i - I)^\top + Q$, which
      forgets what was known; "correct" is as above.

    Inside a box where every $F_i$ is affine in each boxed variable (a model quadratic in them)
    $\sum_i \rho_i F_i = F(\hat x)$, so that with "jx" the reported prediction is that of a
    single rule. A term $|x| x$ has that form on either side of zero only: over a box that
    straddles zero its derivative there comes out as large as at the ends, and a warning says
    so.

    Raises:
        ContractError: an end that is no finite number, an upper end not above the lower, a
            component twice, unknown or on a rotation, or an unknown option.

    Source: Ngatini et al., "Comparison of AUV position estimation using Kalman filter,
    ensemble Kalman filter and fuzzy Kalman filter algorithm in the specified trajectories",
    2022, section 3.2.2, corrected; G. Chen, Q. Xie, L. Shieh, "Fuzzy Kalman filtering",
    Information Sciences 109, 1998.
    """

    box: Box | str = eqx.field(static=True, default=(), converter=as_box)
    predictor: str = eqx.field(static=True, default="affine")
    covariance: str = eqx.field(static=True, default="correct")

    def __check_init__(self):
        names = [name for name, _, _ in self.sides]
        for name, low, high in self.sides:
            if names.count(name) > 1:
                raise ContractError(f"fuzzy: box has {name!r} twice")
            if not (math.isfinite(low) and math.isfinite(high)):
                raise ContractError(
                    f"fuzzy: box of {name!r} is {low:g} to {high:g}, not finite"
                )
            if not low < high:
                raise ContractError(
                    f"fuzzy: box of {name!r} is {low:g} to {high:g}; the upper end must be "
                    "above the lower"
                )
        if across := [
            f"{n} {low:g} to {high:g}" for n, low, high in self.sides if low < 0 < high
        ]:
            warnings.warn(
                f"fuzzy: the box straddles zero in {', '.join(across)}: where the model has a "
                "term |x| x of these (drag), its slope at zero is 0, but this box takes it "
                "from its ends; use a box on one side of zero",
                stacklevel=2,
            )
        for field in ("predictor", "covariance"):
            known = CHOICES[field]
            if getattr(self, field) not in known:
                raise ContractError(f"fuzzy: {unknown(field, getattr(self, field), known)}")

    @property
    def sides(self) -> Box:
        """The box, converted."""
        return as_box(self.box)

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Mixture:
        """Every rule starts from the prior."""
        del key
        weights, shifts = self._rules(prior.mean)
        rules = shifts.shape[0]
        return Mixture(_repeated(prior, rules), _logs(weights))

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Mixture,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Mixture:
        """From one state, by every rule's linear model."""
        del key
        centre = belief.moments().mean
        states = space(centre)
        weights, shifts = self._rules(centre)
        noises = space(vehicle.noise_density())
        after = vehicle.step(centre, control, noises.unflatten(noises.zeros()), dt)

        def rule(shift: Float[Array, " n"], cov: Float[Array, "n n"]) -> Gaussian:
            corner = states.boxplus(centre, shift)
            line = line_at(vehicle, corner, centre, control, dt)
            mean = line.predicted(centre, "jx") if self.predictor == "jx" else after
            return Gaussian(mean, line.spread(cov, self.covariance))

        return Mixture(jax.vmap(rule)(shifts, belief.components.cov), _logs(weights))

    def update(
        self,
        model: AbstractMeasurementModel,
        belief: Mixture,
        measurement: Any,
        key: PRNGKeyArray,
    ) -> tuple[Mixture, Innovation]:
        """Correct every rule as the extended filter does."""

        def correct(rule: Gaussian) -> tuple[Gaussian, Innovation]:
            return ExtendedKalman().update(model, rule, measurement, key)

        rules, scores = jax.vmap(correct)(belief.components)
        score = mixture_innovation(belief.log_weights, scores, model.dof())
        return belief._replace(components=rules), score

    def _rules(self, centre: Any) -> tuple[Float[Array, " rules"], Float[Array, "rules n"]]:
        """Weight of each rule, and the tangent vector from the estimate to its corner."""
        states = space(centre)
        at = coordinates(centre)
        if not self.sides:
            return jnp.ones(1, at.dtype), jnp.zeros((1, states.size), at.dtype)
        places = jnp.array([_place(states, name) for name, _, _ in self.sides])
        lower = jnp.array([low for _, low, _ in self.sides], at.dtype)
        upper = jnp.array([high for _, _, high in self.sides], at.dtype)
        values = at[places]
        ends = jnp.where(corners(len(self.sides)), upper[None], lower[None]) - values[None]
        shifts = jnp.zeros((ends.shape[0], states.size), at.dtype).at[:, places].set(ends)
        return memberships(values, lower, upper), shifts


def _place(states: Space, name: str) -> int:
    labels = states.labels
    if name not in labels:
        raise ContractError(f"fuzzy: box: {unknown('component', name, list(labels))}")
    charts = [chart for chart in states.charts for _ in range(chart.size)]
    place = labels.index(name)
    if charts[place].shape != charts[place].tangent_shape:
        raise ContractError(
            f"fuzzy: box: {name!r} is a component of a rotation, which has no lower and upper "
            "end; use Euler angles or leave it out"
        )
    return place


def _repeated(tree: Any, count: int) -> Any:
    def repeat(leaf: Any) -> Array:
        leaf = jnp.asarray(leaf)
        return jnp.broadcast_to(leaf, (count, *leaf.shape))

    return jax.tree.map(repeat, tree)


def _logs(weights: Float[Array, " rules"]) -> Float[Array, " rules"]:
    """Finite for a rule that does not count, so that a belief is finite throughout."""
    return jnp.log(jnp.maximum(weights, jnp.finfo(weights.dtype).tiny))

"""Linear models from plain matrices: the textbook's F, Q, H and R."""

import functools as ft
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Shaped

from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.errors import ContractError, DataError
from kedge.core.manifolds import Euclidean, space
from kedge.core.quantities import Scalar
from kedge.estimation.log import SECOND, Log, Readings, Recording, Schedule
from kedge.estimation.rig import Installation, Rig
from kedge.numerics.linalg import square_root

Numbers = ArrayLike | Sequence[Any]
"""An array, or numbers in lists."""
SENSOR = "z"
DIFFUSE = 1e7
"""Variance of a diffuse prior, in units of the largest variance of the noise."""


@ft.cache
def vector_class(name: str, **sizes: int) -> Any:
    """A ``NamedTuple`` of vectors, each with its number of components, without units."""
    fields = [
        (field, Annotated[Float[Array, f"{size}"], Euclidean("1", (size,))])
        for field, size in sizes.items()
    ]
    return NamedTuple(name, fields)


class Step(NamedTuple):
    """What a step of a linear model is made of, where it changes from step to step."""

    F: Float[Array, "*T n n"]
    L: Float[Array, "*T n k"]
    """Root of the covariance of the noise: $L L^\\top = G Q G^\\top$."""
    shift: Float[Array, "*T n"]
    """What the input adds: $B u$."""


class LinearVehicle(AbstractVehicle[Any, Any, Any]):
    r"""$x_{k+1} = F_k x_k + B_k u_k + G_k w_k$ with $w_k \sim N(0, Q_k)$.

    The matrices of a step come as its control: that of the log, or the same ones always. Q is
    the covariance of one step, not a density; every step takes ``period`` seconds.

    Source: B. Anderson, J. Moore, "Optimal Filtering", 1979, section 3.1.
    """

    nominal: Step
    period: float = eqx.field(static=True, default=1.0)

    def step(self, state: Any, control: Any, noise: Any, dt: Scalar) -> Any:
        (x,), (w,) = state, noise
        return type(state)(control.F @ x + control.shift + control.L @ w)

    def noise_density(self) -> Any:
        # The drivers divide by the root of the period: what acts is of variance 1.
        size = self.nominal.L.shape[-1]
        return vector_class("Noise", w=size)(jnp.full(size, self.period**0.5))

    def start(self) -> Any:
        size = self.nominal.F.shape[-1]
        return vector_class("State", x=size)(jnp.zeros(size))

    def nominal_control(self, time: Scalar) -> Step:
        return self.nominal


class Matrix(NamedTuple):
    """One measurement matrix for each target; a reading names its own."""

    H: Float[Array, "*T m n"]


class LinearSensor(AbstractSensor[Any]):
    r"""$z = H x + v$ with $v \sim N(0, R)$.

    Source: B. Anderson, J. Moore, "Optimal Filtering", 1979, section 3.1.
    """

    target: Matrix
    R: Float[Array, "m m"]

    @property
    def reads(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The state, of as many components as H has columns."""
        return vector_class("Reads", x=self.target.H.shape[-1])

    @property
    def measures(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        """As many components as H has rows."""
        return vector_class("Measurement", z=self.target.H.shape[-2])

    def observe(self, state: Any) -> Any:
        return self.measures(self.target.H @ state.x)

    def noise_std(self, state: Any) -> Any:
        del state
        return self.measures(jnp.sqrt(jnp.diag(self.R)))

    def noise_cov(self, state: Any) -> Float[Array, "m m"]:
        del state
        return self.R


class LinearModel(eqx.Module):
    """A linear model; :func:`linear_model` makes it. Gradients by its matrices exist."""

    F: Float[Array, "... n n"]
    Q: Float[Array, "... k k"]
    H: Float[Array, "... m n"]
    R: Float[Array, "... m m"]
    B: Float[Array, "... n u"]
    G: Float[Array, "... n k"]
    period: float = eqx.field(static=True, default=1.0)

    @property
    def vehicle(self) -> LinearVehicle:
        """How the state moves; where that changes from step to step, as in the first."""
        first = jax.tree.map(lambda leaf: leaf[0], self._steps(1, None))
        return LinearVehicle(first, self.period)

    @property
    def sensor(self) -> LinearSensor:
        """What is measured."""
        H = self.H if self.H.ndim == 3 else self.H[None]
        return LinearSensor(Matrix(H), self.R if self.R.ndim == 2 else self.R[0])

    def rig(
        self, mean: Numbers | None = None, cov: Numbers | None = None, gate: float | None = None
    ) -> Rig:
        """The model with a prior: mean 0 unless given, and diffuse unless ``cov`` is given.

        Raises:
            ContractError: mean or covariance do not fit F.
        """
        vehicle = self.vehicle
        start = vehicle.start()
        size = space(start).size
        if mean is not None:
            start = type(start)(_fitting("mean", mean, (size,)))
        prior = diffuse(start, DIFFUSE * self._largest_variance())
        if cov is not None:
            prior = Gaussian(start, _fitting("cov", cov, (size, size)))
        return Rig(vehicle, (Installation(SENSOR, self.sensor, gate=gate),), prior)

    def log(
        self, measurements: Numbers, inputs: Numbers | None = None, first: int = 1
    ) -> Recording:
        """Measurements, a row for each step, as a log; NaN for what was not measured.

        ``first`` is how many steps after the prior the first row was measured: 1 if the model
        predicts before it is corrected, 0 if the prior is already of that time. Row k of
        ``inputs`` and of matrices by step acts in the step that leads to row k of the
        measurements.

        Raises:
            DataError: the rows do not fit the model, or each other.
        """
        z = jnp.asarray(measurements, float)
        z = z[:, None] if z.ndim == 1 else z
        if z.ndim != 2 or z.shape[1] != self.H.shape[-2] or len(z) == 0:
            raise DataError(
                f"measurements: found shape {z.shape}, expected one row of {self.H.shape[-2]} "
                "for each step"
            )
        if first not in (0, 1):
            raise DataError(f"first: found {first}, expected 0 or 1")
        count = len(z)
        number = np.arange(count)
        targets = jnp.asarray(number if self.H.ndim == 3 else np.zeros_like(number))
        for name in ("F", "Q", "H", "R", "B", "G"):
            rows = getattr(self, name)
            if rows.ndim == 3 and len(rows) != count:
                raise DataError(f"{name}: found {len(rows)} steps, expected {count}")
        covs = self.R if self.R.ndim == 3 else None
        sensor = self.sensor
        schedule = Schedule(
            jnp.asarray((number + first) * self.period),
            jnp.zeros(count, int),
            jnp.asarray(number),
        )
        events = Log(
            schedule, self._steps(count, inputs), (Readings(sensor.measures(z), targets, covs),)
        )
        stamps = np.round((number + first) * self.period * SECOND).astype(np.int64)
        return Recording(events, 0, stamps, number)

    def _steps(self, count: int, inputs: Numbers | None) -> Step:
        """The matrices of so many steps."""
        F, Q, B, G = (
            jnp.broadcast_to(leaf, (count, *leaf.shape[-2:]))
            if leaf.ndim == 2
            else leaf[:count]
            for leaf in (self.F, self.Q, self.B, self.G)
        )
        width = B.shape[-1]
        u = jnp.zeros((count, width)) if inputs is None else jnp.asarray(inputs, float)
        u = u[:, None] if u.ndim == 1 else u
        if u.shape != (count, width):
            raise DataError(f"inputs: found shape {u.shape}, expected {(count, width)}")
        L = G @ jax.vmap(square_root)(Q)
        return Step(F, L, jnp.einsum("kij,kj->ki", B, u))

    def _largest_variance(self) -> Array:
        return jnp.maximum(
            jnp.max(jnp.diagonal(self.R, axis1=-2, axis2=-1)),
            jnp.max(jnp.diagonal(self.Q, axis1=-2, axis2=-1)),
        )


def linear_model(
    F: Numbers,
    Q: Numbers,
    H: Numbers,
    R: Numbers,
    B: Numbers | None = None,
    G: Numbers | None = None,
    period: float = 1.0,
) -> LinearModel:
    r"""The linear model $x_{k+1} = F x_k + B u_k + G w_k$, $z_k = H x_k + v_k$.

    $w \sim N(0, Q)$, $v \sim N(0, R)$. Q is the covariance of a step, not a density. Each
    matrix may change with the steps: then it has a leading axis, one matrix a step.
    ``estimate(filters.Kalman(), model.rig(mean, cov), model.log(z))`` gives the estimates after
    each row of z, ``smooth`` those in the light of all rows, and ``.log_likelihood`` that of z.
    It has gradients by every matrix; where Q is singular give G and a smaller Q, since a root
    has no derivative there.

    Raises:
        ContractError: the matrices do not fit together.

    Source: B. Anderson, J. Moore, "Optimal Filtering", 1979, section 3.1.
    """
    F, Q, H, R = (jnp.atleast_2d(jnp.asarray(leaf, float)) for leaf in (F, Q, H, R))
    n, m, k = F.shape[-1], H.shape[-2], Q.shape[-1]
    B = jnp.zeros((n, 0)) if B is None else jnp.asarray(B, float)
    G = jnp.eye(n) if G is None else jnp.asarray(G, float)
    expected = {"F": (n, n), "Q": (k, k), "H": (m, n), "R": (m, m), "G": (n, k)}
    given = {"F": F, "Q": Q, "H": H, "R": R, "B": B, "G": G}
    for name, leaf in given.items():
        wanted = expected.get(name, (n, leaf.shape[-1] if leaf.ndim else 0))
        if leaf.ndim not in (2, 3) or leaf.shape[-2:] != wanted:
            raise ContractError(
                f"linear_model: {name} has the shape {leaf.shape}, expected {wanted}, or one "
                "such matrix for each step"
            )
    if not period > 0:
        raise ContractError(f"linear_model: period is {period}, expected above 0 s")
    return LinearModel(F, Q, H, R, B, G, float(period))


def diffuse(mean: Any, variance: Scalar | float = 1e6) -> Gaussian:
    r"""A prior that knows next to nothing: $P_0 = \kappa I$ about ``mean``.

    What it leaves in the estimates is of the order of the readings' variance over
    ``variance``, what it costs in rounding of the order of $10^{-16}$ ``variance`` over theirs:
    about $10^7$ times their variance is a good choice. The likelihood of as many readings as
    there are diffuse components hangs on ``variance``: leave them out when likelihoods of
    models with other diffuse states are compared.

    Source: A. Harvey, "Forecasting, Structural Time Series Models and the Kalman Filter", 1989,
    section 3.3.4 (the large-kappa approximation).
    """
    return Gaussian(mean, jnp.eye(space(mean).size) * variance)


def _fitting(name: str, value: Numbers, shape: tuple[int, ...]) -> Shaped[Array, "..."]:
    array = jnp.asarray(value, float)
    if array.shape != shape:
        raise ContractError(f"{name} has the shape {array.shape}, expected {shape}")
    return array

"""The three contracts: vehicle, sensor, filter.

A vehicle never knows which filter runs it, a filter never knows which vehicle it runs, and
a sensor knows only the names of the state fields that it reads.
"""

import abc
import math
from typing import Any, ClassVar, Generic, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray
from typing_extensions import TypeVar

from kedge.core.beliefs import Gaussian
from kedge.core.manifolds import space, space_of
from kedge.core.quantities import Scalar

S = TypeVar("S", default=Any)  # state
U = TypeVar("U", default=Any)  # control
W = TypeVar("W", default=Any)  # process noise
Z = TypeVar("Z", default=Any)  # measurement
B = TypeVar("B", default=Any)  # belief


class AbstractVehicle(eqx.Module, Generic[S, U, W]):
    r"""Stochastic motion $x' = f(x, u, w, \Delta t)$ with $w \sim N(0, Q / \Delta t)$.

    The one ``step`` is simulated, linearised, sampled and propagated through sigma points,
    so nothing else has to be written for a filter to use the vehicle. Noise that depends on
    the state or the control is written there too: multiply the noise by what it depends on.
    """

    @abc.abstractmethod
    def step(self, state: S, control: U, noise: W, dt: Scalar) -> S:
        """Advance the state by ``dt`` seconds."""

    @abc.abstractmethod
    def noise_density(self) -> W:
        """Root power spectral density of each noise channel, in its unit per root hertz."""

    @abc.abstractmethod
    def start(self) -> S:
        """A representative initial state."""

    @abc.abstractmethod
    def nominal_control(self, time: Scalar) -> U:
        """A representative control at ``time`` seconds: the default scenario."""

    def longest_step(self) -> float:
        """The longest ``dt`` in s for which ``step`` is stable; drivers refuse a longer one.

        It is asked before tracing.
        """
        return math.inf

    def control_limits(self) -> U | None:
        """How large a control can get: what is told beyond acts as that; None without limits.

        Logs that tell of more are not refused, but it is counted and said.
        """
        return None


class AbstractOdeVehicle(AbstractVehicle[S, U, W]):
    r"""A vehicle given by $\dot x = f(x, u, w)$, advanced by one Runge-Kutta step.

    The classical rule is applied in the chart at the start of the step, so its order is four
    on flat fields and two on rotations (the correction for a moving chart is left out).

    The noise is held over the step. A position that white acceleration moves gets
    $q\,\Delta t^3 / 4$ of variance for the $q\,\Delta t^3 / 3$ of noise that is white in
    continuous time, and $q\,\Delta t^5 / 36$ for $q\,\Delta t^5 / 20$ if it is the jerk. For
    the exact form write ``step`` with more channels of noise, as
    ``continuous-white-acceleration`` does.
    """

    @abc.abstractmethod
    def rates(self, state: S, control: U, noise: W) -> S:
        """Time derivative of every state field, in its unit per second."""

    def step(self, state: S, control: U, noise: W, dt: Scalar) -> S:
        """Advance on the manifold by the classical fourth-order rule."""
        states = space(state)

        def slope(error):
            return states.flatten(self.rates(states.boxplus(state, error), control, noise))

        k1 = slope(states.zeros())
        k2 = slope(dt / 2 * k1)
        k3 = slope(dt / 2 * k2)
        k4 = slope(dt * k3)
        return states.boxplus(state, dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4))


class Ranging(NamedTuple):
    r"""Ranges from p: $z_i = s_i \sqrt{\lVert p - a_i \rVert^2 + h_i^2} + b_i + \mu_i$."""

    anchors: Float[Array, "m d"]
    scale: Float[Array, " m"]
    bias: Float[Array, " m"]
    """Known of the instruments."""
    excess: Float[Array, " m"]
    """Expected of obstacles, on top."""
    rise: Float[Array, " m"]
    """Height of the tag over each anchor, where p is in the plane."""
    present: Bool[Array, " m"]
    """False where the reading lacks a range."""


class AbstractMeasurementModel(eqx.Module, Generic[Z]):
    r"""Observation $z = h(x) \boxplus v$ with $v \sim N(0, R(x))$: all a filter ever sees."""

    @abc.abstractmethod
    def expect(self, state: Any) -> Z:
        """The noise-free measurement of a vehicle state."""

    @abc.abstractmethod
    def noise_cov(self, state: Any) -> Float[Array, "m m"]:
        """Covariance of the measurement noise at a vehicle state."""

    @abc.abstractmethod
    def dof(self) -> Int[Array, ""] | int:
        """How many components of the measurement are there."""

    def noise_variance(self, state: Any) -> Float[Array, " m"] | None:
        """Diagonal of ``noise_cov`` if its components are independent by construction.

        None if that is not known before tracing; filters of large measurements then need the
        whole matrix.
        """
        del state
        return None

    def distances(self, state: Any) -> Float[np.ndarray, "m n"] | None:
        """How far each measured component lies from each component of the state.

        In any one unit, NaN for components without a place; None if there are no distances,
        and then filters that localise refuse the measurement. It follows from the types alone,
        before tracing: ``state`` is looked at for its class only.
        """
        del state
        return None

    def ranging(self, state: Any) -> Ranging | None:
        """What a position can be found from; None if it does not measure ranges to anchors."""
        del state
        return None

    def source(self) -> str:
        """Name of the installed sensor; filters that learn keep what they learn by it."""
        return ""


class AbstractSensor(AbstractMeasurementModel[Z]):
    """A measurement model that works on every vehicle with the state fields it reads.

    A sensor over a map (landmarks, beacons, anchors) has a field ``target``: a ``NamedTuple``
    of one target's parameters. The installed sensor carries the whole map there, with a
    leading axis, and :meth:`for_target` picks the target that a reading names.
    """

    reads: ClassVar[Any]
    """A ``NamedTuple`` of the state fields that the sensor reads; it is shown nothing else.
    A field with a default is optional: without it in the state the default is used."""
    measures: ClassVar[Any]
    """The ``NamedTuple`` that the sensor returns."""
    nominal_rate: ClassVar[float] = 1.0
    """Rate in Hz at which scenarios fire the sensor unless told otherwise."""
    positive: ClassVar[tuple[str, ...]] = ()
    """Components that are above 0 by their nature: others in a log are no measurements."""

    @abc.abstractmethod
    def observe(self, state: Any) -> Z:
        """The noise-free measurement, from the fields in ``reads``."""

    @abc.abstractmethod
    def noise_std(self, state: Any) -> Z:
        """Standard deviation of each measurement component, in its unit."""

    def expect(self, state: Any) -> Z:
        """Show the sensor its fields of the whole state."""
        return self.observe(self.project(state))

    def noise_cov(self, state: Any) -> Float[Array, "m m"]:
        """Independent components: the squares of ``noise_std`` on the diagonal."""
        return jnp.diag(self._variance(state))

    def noise_variance(self, state: Any) -> Float[Array, " m"] | None:
        """The squares of ``noise_std``, unless the sensor has a ``noise_cov`` of its own."""
        correlated = type(self).noise_cov is not AbstractSensor.noise_cov
        return None if correlated else self._variance(state)

    def dof(self) -> int:
        """Size of the measurement."""
        return space_of(self.measures).size

    def possible(self, state: Any, measurement: Z) -> Bool[Array, ""] | bool:
        """Whether the sensor, with its noise, would read this anywhere.

        What the sensor itself is like (its scale, its bias) is that of the state.
        """
        del state, measurement
        return True

    def project(self, state: Any) -> Any:
        """The fields in ``reads`` of a state, defaults filled in."""
        fields = (f for f in self.reads._fields if hasattr(state, f))
        return self.reads(**{f: getattr(state, f) for f in fields})

    def _variance(self, state: Any) -> Float[Array, " m"]:
        return space_of(self.measures).flatten(self.noise_std(self.project(state))) ** 2

    def for_target(self, index: Int[Array, ""] | int) -> "AbstractSensor[Z]":
        """The sensor looking at target ``index`` of its map; itself if it has no map."""
        targets = getattr(self, "target", None)
        if targets is None:
            return self
        one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[index], targets)
        return eqx.tree_at(lambda sensor: sensor.target, self, one)


class Innovation(NamedTuple):
    """What an update learned, kept for gating, consistency tests and plots."""

    residual: Float[Array, " m"]
    cov: Float[Array, "m m"]
    nis: Float[Array, ""]
    """Normalised innovation squared: chi-square with ``dof`` degrees of freedom."""
    dof: Int[Array, ""] | int
    log_likelihood: Float[Array, ""]
    accepted: Bool[Array, ""] | bool = True
    threshold: Float[Array, ""] | float = float("inf")
    """Bound on ``nis`` beyond which a gate refuses the reading."""
    effective_size: Float[Array, ""] | float = float("nan")
    """Effective number of particles after weighing, before resampling: 0 if none explains the
    reading, NaN for filters without weights."""
    outlying: Bool[Array, ""] | bool = False
    """Whether a gate refused the reading, or a robust loss weighed it down, as an outlier."""
    resampled: Bool[Array, ""] | bool = False
    """Whether particles were resampled."""
    repairs: Int[Array, ""] | int = 0
    """How many pivots of a covariance had to be lifted to zero for this update."""


class AbstractFilter(eqx.Module, Generic[B]):
    """A recursive estimator as three pure functions of a belief."""

    def bind_sensors(self, sources: tuple[str, ...]) -> "AbstractFilter[B]":
        """The filter, told by the driver which installed sensors it will hear of."""
        del sources
        return self

    @abc.abstractmethod
    def init(self, prior: Gaussian, key: PRNGKeyArray) -> B:
        """Represent a Gaussian prior as this filter's belief."""

    @abc.abstractmethod
    def predict(
        self, vehicle: AbstractVehicle, belief: B, control: Any, dt: Scalar, key: PRNGKeyArray
    ) -> B:
        """Advance the belief by ``dt`` seconds."""

    @abc.abstractmethod
    def update(
        self, model: AbstractMeasurementModel, belief: B, measurement: Any, key: PRNGKeyArray
    ) -> tuple[B, Innovation]:
        """Condition the belief on one measurement."""

    def recovery_time(self) -> float:
        """After how many s of nothing but outliers of a sensor its next reading is let in."""
        return math.inf

    def considers(self) -> bool:
        """Whether it leaves the states uncorrected that are to be considered only."""
        return False

    def weighing(self, loss: Any) -> "AbstractFilter[B] | None":
        """Itself with a sensor's robust loss built in; None if the driver is to wrap it."""
        del loss
        return None

    def trusting(self) -> "AbstractFilter[B]":
        """The filter for the same beliefs without its gates and robust losses."""
        return self

    def reset(self, belief: B, factor: Scalar) -> B:
        """The belief after divergence, inflated, from which the state is looked for again.

        ``factor`` is by how much its covariance was too small, as far as a reading can tell.
        """
        wrong: Any = belief
        return wrong.inflated(factor)


class AbstractGaussianFilter(AbstractFilter[Any]):
    """A filter whose belief is one Gaussian and whose prediction can be smoothed.

    The belief is a ``Gaussian`` unless ``init`` makes another form of it.
    """

    @abc.abstractmethod
    def transition(
        self, vehicle: AbstractVehicle, belief: Any, control: Any, dt: Scalar
    ) -> tuple[Any, Float[Array, "n n"]]:
        """The predicted belief, and the covariance of the state before with that after."""

    def init(self, prior: Gaussian, key: PRNGKeyArray) -> Any:
        """The prior itself."""
        del key
        return prior

    def predict(
        self,
        vehicle: AbstractVehicle,
        belief: Any,
        control: Any,
        dt: Scalar,
        key: PRNGKeyArray,
    ) -> Any:
        """The transition without its cross-covariance."""
        del key
        return self.transition(vehicle, belief, control, dt)[0]

"""The kinds of faults."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.core.quantities import Ratio, Scalar, Seconds
from kedge.core.registry import faults
from kedge.simulation.faults import (
    AbstractDeliveryFault,
    AbstractHoldingFault,
    AbstractReadingFault,
    AbstractTimeFault,
    When,
)


def check(fault: Any, low: float | int, high: float | int, *names: str) -> None:
    """Refuse numbers out of their range; what is traced was checked before.

    Raises:
        ContractError: one is.
    """
    for name in names:
        value = getattr(fault, name)
        if isinstance(value, int | float) and not low <= value <= high:
            bounds = f"{low:g} or more" if high == np.inf else f"{low:g} to {high:g}"
            raise ContractError(f"{name} is {value:g}, expected {bounds}")


class AbstractLoss(AbstractReadingFault):
    """What is drawn are the components that are missing."""

    def change(
        self, chosen: np.ndarray, reading: Any, drawn: Any, std: Float[Array, " m"]
    ) -> Any:
        return without(reading, drawn & jnp.asarray(chosen))


class AbstractError(AbstractReadingFault):
    """What is drawn is added, in tangent coordinates."""

    def change(
        self, chosen: np.ndarray, reading: Any, drawn: Any, std: Float[Array, " m"]
    ) -> Any:
        return space(reading).boxplus(reading, jnp.where(chosen, drawn, 0.0))


@faults.add("dropout")
class Dropout(AbstractLoss):
    """A reading is lost as a whole; a control is, and the one before is held."""

    probability: Ratio = 1.0
    component: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check(self, 0, 1, "probability")

    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Bool[Array, "n m"]:
        lost = when.active & (jr.uniform(key, when.time.shape) < self.probability)
        return jnp.repeat(lost[:, None], size, axis=1)


@faults.add("nan")
class NotANumber(AbstractLoss):
    """Each component, by itself, is no number."""

    probability: Ratio = 0.1
    component: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check(self, 0, 1, "probability")

    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Bool[Array, "n m"]:
        bad = jr.uniform(key, (len(when.time), size)) < self.probability
        return when.active[:, None] & bad


@faults.add("bias")
class Bias(AbstractError):
    """A constant is added: ``value``, and one drawn for each run and component."""

    value: Scalar = 0.0
    std: Scalar = 0.0
    component: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check(self, 0, np.inf, "std")

    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Float[Array, "n m"]:
        constant = self.value + self.std * jr.normal(key, (size,))
        return when.active[:, None] * constant[None]


@faults.add("blocked")
class Blocked(AbstractError):
    """Ranges around obstacles: ``links`` components of each reading, at random, are longer.

    By ``excess``, normal noise of ``std`` and an exponential part of mean ``tail``.
    """

    links: int = eqx.field(static=True, default=1)
    excess: Scalar = 0.0
    std: Scalar = 0.0
    tail: Scalar = 0.5
    probability: Ratio = 1.0
    component: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check(self, 0, np.inf, "links", "std", "tail")
        check(self, 0, 1, "probability")

    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Float[Array, "n m"]:
        which, blocked, normal, tail = jr.split(key, 4)
        shape = len(when.time), size
        # The rank of each component in a random order; no order has ties.
        order = jnp.argsort(jr.uniform(which, shape), axis=1)
        hit = jnp.argsort(order, axis=1) < self.links
        blocked = when.active & (jr.uniform(blocked, when.time.shape) < self.probability)
        longer = self.excess + self.std * jr.normal(normal, shape)
        longer = longer + self.tail * jr.exponential(tail, shape)
        return jnp.where(hit & blocked[:, None], longer, 0.0)


@faults.add("drift")
class Drift(AbstractError):
    """What is added grows since the fault began: by ``rate``, and one drawn for each run."""

    rate: Scalar = 0.0  # of the component, 1/s
    std: Scalar = 0.0  # the same
    component: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check(self, 0, np.inf, "std")

    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Float[Array, "n m"]:
        rate = self.rate + self.std * jr.normal(key, (size,))
        since = jnp.where(when.active, when.since, 0.0)
        return since[:, None] * rate[None]


@faults.add("outliers")
class Outliers(AbstractReadingFault):
    """Some readings have normal noise on top, ``scale`` times that of their sensor.

    In episodes and with the probability 1 these are bursts. A control has no noise to scale:
    there, ``scale`` is the standard deviation itself.
    """

    probability: Ratio = 0.05
    scale: Ratio = 10.0
    component: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check(self, 0, 1, "probability")
        check(self, 0, np.inf, "scale")

    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Float[Array, "n m"]:
        hit_key, noise_key = jr.split(key)
        hit = when.active & (jr.uniform(hit_key, when.time.shape) < self.probability)
        noise = self.scale * jr.normal(noise_key, (len(when.time), size))
        return jnp.where(hit[:, None], noise, 0.0)

    def change(
        self, chosen: np.ndarray, reading: Any, drawn: Any, std: Float[Array, " m"]
    ) -> Any:
        return space(reading).boxplus(reading, jnp.where(chosen, drawn * std, 0.0))


@faults.add("excess")
class Excess(AbstractError):
    """What comes on a detour: ``offset`` and an exponential with a ``mean`` are added.

    For ranges without a line of sight, which are never too short.
    """

    offset: Scalar = 0.0
    mean: Scalar = 0.5
    probability: Ratio = 1.0
    component: str = eqx.field(static=True, default="")

    def __check_init__(self):
        check(self, 0, 1, "probability")
        check(self, 0, np.inf, "mean")

    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Float[Array, "n m"]:
        there_key, length_key = jr.split(key)
        delayed = jr.uniform(there_key, when.time.shape) < self.probability
        length = self.offset + self.mean * jr.exponential(length_key, (len(when.time), size))
        return jnp.where((when.active & delayed)[:, None], length, 0.0)


@faults.add("quantisation")
class Quantisation(AbstractReadingFault):
    """Components are rounded to whole steps."""

    step: Scalar = 1.0
    component: str = eqx.field(static=True, default="")

    def __check_init__(self):
        if isinstance(self.step, int | float) and not self.step > 0:
            raise ContractError(f"step is {self.step:g}, expected above 0")

    def draw(self, key: PRNGKeyArray, when: When, size: int) -> Bool[Array, "n m"]:
        return jnp.repeat(when.active[:, None], size, axis=1)

    def change(
        self, chosen: np.ndarray, reading: Any, drawn: Any, std: Float[Array, " m"]
    ) -> Any:
        outputs = space(reading)
        gaps = type(reading)(*(jnp.full(jnp.shape(leaf), jnp.nan) for leaf in reading))
        origin, _ = outputs.complete(gaps)
        value = outputs.boxminus(reading, origin)
        rounding = jnp.round(value / self.step) * self.step - value
        return outputs.boxplus(reading, jnp.where(drawn & jnp.asarray(chosen), rounding, 0.0))


@faults.add("stuck")
class Stuck(AbstractHoldingFault):
    """The sensor repeats what it read last before the fault; from the start, its first."""

    def source(self, when: When) -> Int[Array, " n"]:
        number = jnp.arange(len(when.time))
        return lax.cummax(jnp.where(when.active, 0, number))


@faults.add("delay")
class Delay(AbstractTimeFault):
    """Readings were taken ``delay`` before their stamps, and nobody says so."""

    delay: Seconds = 0.1

    def __check_init__(self):
        check(self, 0, np.inf, "delay")

    def lag(self, key: PRNGKeyArray, when: When) -> Float[Array, " n"]:
        return jnp.where(when.active, self.delay, 0.0)


@faults.add("jitter")
class Jitter(AbstractTimeFault):
    """Stamps err by normal noise."""

    std: Seconds = 0.01

    def __check_init__(self):
        check(self, 0, np.inf, "std")

    def lag(self, key: PRNGKeyArray, when: When) -> Float[Array, " n"]:
        return jnp.where(when.active, self.std * jr.normal(key, when.time.shape), 0.0)


@faults.add("clock")
class Clock(AbstractTimeFault):
    r"""The sensor's clock is ahead of the truth by an offset, a drift and a jump.

    It shows $s = t + o + d\,t + j\,[s \ge s_j]$ at the true time t, so what is stamped s was
    read at $t = (s - o - j\,[s \ge s_j]) / (1 + d)$.
    """

    offset: Seconds = 0.0
    drift: Ratio = 0.0  # s/s
    jump: Seconds = 0.0
    jump_at: Seconds = 0.0  # as it shows

    def __check_init__(self):
        if isinstance(self.drift, int | float) and not self.drift > -1:
            raise ContractError(f"drift is {self.drift:g}, expected above -1: time goes on")

    def lag(self, key: PRNGKeyArray, when: When) -> Float[Array, " n"]:
        jumped = jnp.where(when.time >= self.jump_at, self.jump, 0.0)
        true = (when.time - self.offset - jumped) / (1 + self.drift)
        return jnp.where(when.active, when.time - true, 0.0)


@faults.add("duplicate")
class Duplicate(AbstractDeliveryFault):
    """Some messages come again, ``after`` seconds later."""

    probability: Ratio = 0.1
    after: Seconds = 0.0

    def __check_init__(self):
        check(self, 0, 1, "probability")
        check(self, 0, np.inf, "after")

    def delays(self, key: PRNGKeyArray, when: When) -> Float[Array, "n 2"]:
        twice = when.active & (jr.uniform(key, when.time.shape) < self.probability)
        return jnp.stack([jnp.zeros(len(twice)), jnp.where(twice, self.after, jnp.inf)], axis=1)


@faults.add("out-of-order")
class OutOfOrder(AbstractDeliveryFault):
    """Some messages are on their way for an exponential time, and others overtake them."""

    probability: Ratio = 0.1
    delay: Seconds = 0.5  # in the mean

    def __check_init__(self):
        check(self, 0, 1, "probability")
        check(self, 0, np.inf, "delay")

    def delays(self, key: PRNGKeyArray, when: When) -> Float[Array, "n 2"]:
        which_key, long_key = jr.split(key)
        late = when.active & (jr.uniform(which_key, when.time.shape) < self.probability)
        long = self.delay * jr.exponential(long_key, when.time.shape)
        return jnp.stack(
            [jnp.where(late, long, 0.0), jnp.full(len(late), jnp.inf)],
            axis=1,
        )


def without(reading: Any, gone: Bool[Array, " m"]) -> Any:
    """A reading with NaN for some components; an attitude is there as a whole or not at all."""
    outputs, kept = space(reading), []
    for chart, leaf, cut in zip(
        outputs.charts, reading, outputs.slices().values(), strict=True
    ):
        mine = gone[cut]
        whole = chart.shape != chart.tangent_shape
        mask = mine.any() if whole else mine.reshape(chart.shape)
        kept.append(jnp.where(mask, jnp.nan, leaf))
    return type(reading)(*kept)

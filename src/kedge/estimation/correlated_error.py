"""An error of a sensor with a memory: a bias that is forgotten after some seconds."""

import re
from collections.abc import Sequence
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from kedge.core.manifolds import charts_of, space
from kedge.core.quantities import Scalar

Treatment = Literal["estimated", "considered", "widened"]
MOST = 1e4
"""Readings that are counted as one at the most; more would be none."""


class CorrelatedError(eqx.Module):
    r"""What a sensor errs by beside its white noise: a stationary Gauss-Markov process.

    $e' = e^{-\Delta t / \tau} e + w$ with the standard deviation ``std`` at all times, one
    value or one for each component of the measurement; ``time_constant`` is $\tau$ in s.

    ``by_target`` gives each target of a map an error of its own, as delays of antennas, echoes
    and printed markers have; else all share one, as those of the tag or camera itself do.

    * estimated: errors are states, and readings correct them.
    * considered: errors are states that widen every update and are corrected by none (Schmidt).
    * widened: no states; a reading's variance grows by
      $\sigma^2 (1 + a) / (1 - a)$, $a = e^{-\Delta t / \tau}$, with the time since the last
      reading of this sensor (and target) that was fused: a train of such readings tells of a
      constant as much as one with the error does.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking and
    Navigation", 2001, section 8.4 (augmentation); S. Schmidt, "Application of state-space
    methods to navigation problems", Advances in Control Systems 3, 1966; H. Thiébaux and
    F. Zwiers, "The interpretation and estimation of effective sample size", J. Climate and
    Applied Meteorology 23, 1984.
    """

    std: Scalar | Float[Array, " m"]
    time_constant: Scalar | Float[Array, " m"]
    by_target: bool = eqx.field(static=True, default=False)
    treatment: Treatment = eqx.field(static=True, default="estimated")

    @property
    def is_state(self) -> bool:
        """Whether the error is a part of the vehicle's state."""
        return self.treatment != "widened"

    def extra_variance(self, dt: Scalar, size: int) -> Float[Array, " m"]:
        """What is added to a reading's variances, ``dt`` s after the last one."""
        std = jnp.broadcast_to(jnp.asarray(self.std, float), (size,))
        decay = -jnp.expm1(-dt / jnp.asarray(self.time_constant, float))
        worth = jnp.minimum(2 / jnp.maximum(decay, 1 / MOST) - 1, MOST)
        return std**2 * worth

    def added(
        self,
        expected: Any,
        state: Any,
        target: Int[Array, ""],
        sensor: str,
        targets: int | None,
    ) -> Any:
        """An expected measurement with the errors that the state has of it."""
        errors = self.of_target(expected, state, target, sensor, targets)
        return expected if errors is None else space(expected).boxplus(expected, errors)

    def of_target(
        self,
        expected: Any,
        state: Any,
        target: Int[Array, ""],
        sensor: str,
        targets: int | None,
    ) -> Float[Array, " m"] | None:
        """The errors in the state of one target's reading; None if the state has none."""
        charts, parts = charts_of(type(expected)), []
        for field, chart in charts.items():
            value = getattr(state, state_field(sensor, field), None)
            if value is None:
                parts.append(jnp.zeros(chart.size))
            elif self.by_target:
                # As a product: an index into the state would have no derivative in closed form.
                chosen = jnp.where(jnp.arange(targets or 1) == target, 1.0, 0.0)
                parts.append(chosen @ value.reshape(targets or 1, chart.size))
            else:
                parts.append(value)
        known = [hasattr(state, state_field(sensor, field)) for field in charts]
        return jnp.concatenate(parts) if any(known) else None


def state_field(sensor: str, field: str) -> str:
    """The name in the state of the errors of a field that a sensor measures."""
    return re.sub(r"\W", "_", f"error_of_{sensor}_{field}")


def new_times(sensors: Sequence[Any]) -> tuple[Float[Array, " targets"] | None, ...] | None:
    """For each sensor whose errors widen its noise, that no target was read yet."""
    times = tuple(
        jnp.full(s.targets or 1 if s.error.by_target else 1, -1e9)
        if s.error is not None and not s.error.is_state
        else None
        for s in sensors
    )
    return None if all(time is None for time in times) else times

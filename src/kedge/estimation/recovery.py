r"""Recovery from a wrong belief: a sensor that had nothing but outliers for a time is let in.

A gate or a robust loss trusts the belief more than a reading. Where the belief is wrong, good
readings are outliers for ever. So each sensor has a clock: it runs from the first outlier, a
reading that is none sets it back, and once it shows the recovery time the next outlier is let
in. The belief's covariance is multiplied by $\epsilon / d$ first, the ratio of the normalised
innovation squared to its expectation: what the reading says becomes plausible, so the state
goes there in one update, and its covariance says how little is known. Augmented states keep
theirs: a vehicle that is lost has not changed its wheels or its radios.

Perhaps the *sensor* is wrong: then others that say the same thing confirm the belief. Whether
they do follows from the reset itself. Each reading fused in the last recovery time is expected
again, and compared with what is expected after the reset. If that differs by more than half a
standard deviation, $\epsilon > d / 4$ by the belief after the reset, the other sensor sees what
this one sees: the reading stays an outlier, and its clock starts anew. For one component each,
of correlation r in the belief, that is $r^2 / (1 - r^2) > 1/4$. So two receivers of fixes
confirm each other, and fixes confirm a speed; a Doppler log does not confirm a depth, since the
error of an integral soon has little to do with the present error of the speed. No list is
needed of which sensors belong together, and of the filter no more than its updates.

Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking and
Navigation", 2001, section 5.7.2 (gate). The recovery is kedge's.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from kedge.core.contracts import AbstractFilter, AbstractMeasurementModel, Innovation
from kedge.core.quantities import Scalar
from kedge.estimation.log import Readings
from kedge.estimation.reading import bind_reading
from kedge.estimation.rig import Installation
from kedge.numerics.branching import whenever

CONFIRMED = 0.25
"""NIS by degrees of freedom from which another sensor contradicts a reset."""


class Clocks(NamedTuple):
    """When sensors had outliers, and when they were fused."""

    since: Float[Array, " sensors"]
    """s; the first outlier after the last reading that was none, infinite without."""
    fused: tuple[Float[Array, " targets"], ...]
    """s; by sensor and target, the last reading fused that was no outlier."""

    def due(self, place: int, time: Scalar, recovery: float) -> Bool[Array, ""]:
        """Whether the sensor had nothing but outliers for so long."""
        return time - self.since[place] >= recovery

    def after(
        self,
        place: int,
        target: Int[Array, ""],
        time: Scalar,
        good: Bool[Array, ""],
        outlying: Bool[Array, ""],
        contradicted: Bool[Array, ""],
    ) -> "Clocks":
        """The clocks after a reading that was fused and no outlier, or was an outlier."""
        begun = jnp.where(contradicted, time, jnp.minimum(self.since[place], time))
        since = jnp.where(good, jnp.inf, jnp.where(outlying, begun, self.since[place]))
        times = self.fused[place]
        looked_at = (jnp.arange(len(times)) == target) | (len(times) == 1)
        times = jnp.where(looked_at & good, time, times)
        before, after = self.fused[:place], self.fused[place + 1 :]
        return Clocks(self.since.at[place].set(since), (*before, times, *after))


def new_clocks(filter: AbstractFilter, sensors: Sequence[Installation]) -> Clocks | None:
    """No outlier and nothing fused; None if nothing is ever let in."""
    if not any(math.isfinite(s.judged(filter).recovery_time()) for s in sensors):
        return None
    fused = tuple(jnp.full(s.targets or 1, -jnp.inf) for s in sensors)
    return Clocks(jnp.full(len(sensors), jnp.inf), fused)


def recover(
    filter: AbstractFilter,
    sensors: Sequence[Installation],
    place: int,
    clocks: Clocks,
    belief: Any,
    judged: tuple[Any, Innovation],
    model: AbstractMeasurementModel,
    measurement: Any,
    time: Scalar,
    key: PRNGKeyArray,
    due: Bool[Array, ""],
) -> tuple[Any, Innovation, Bool[Array, ""]]:
    """What was ``judged``, or if ``due`` the reset belief's update; and whether it is that."""
    posterior, score = judged
    score = jax.tree.map(jnp.asarray, score)
    trusting = filter.trusting()
    recovery = sensors[place].judged(filter).recovery_time()
    expected_by = belief.moments().mean

    def contradicts(other: Installation, fused: Float[Array, " targets"], anew: Any) -> Any:
        def by(target: Int[Array, ""]) -> Bool[Array, ""]:
            reading = Readings(other.expect(expected_by, target), target, None)
            # A question, not an update: what it draws is thrown away.
            model, measurement = bind_reading(other, reading)
            outcome = trusting.update(model, anew, measurement, key)[1]
            return ~(outcome.nis <= CONFIRMED * outcome.dof)

        return jnp.any(jax.vmap(by)(jnp.arange(len(fused))) & (time - fused < recovery))

    def attempt() -> tuple[Any, Innovation, Bool[Array, ""]]:
        factor = jnp.maximum(score.nis / jnp.maximum(score.dof, 1), 1.0)
        inflated = filter.reset(belief, jnp.where(jnp.isfinite(factor), factor, 1.0))
        anew, again = trusting.update(model, inflated, measurement, key)
        again = jax.tree.map(jnp.asarray, again._replace(threshold=jnp.inf))
        others = [i for i in range(len(sensors)) if i != place]
        against = [contradicts(sensors[i], clocks.fused[i], anew) for i in others]
        free = ~jnp.any(jnp.stack([jnp.asarray(False), *against]))
        chosen = jax.tree.map(
            lambda new, old: jnp.where(free, new, old), (anew, again), (posterior, score)
        )
        return *chosen, free

    return whenever(due, attempt, lambda: (posterior, score, jnp.asarray(False)))

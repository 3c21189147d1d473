"""The pose of a landmark seen from the vehicle: a marker with an orientation of its own."""

from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractSensor
from kedge.core.manifolds import Euclidean
from kedge.core.quantities import Heading, Metres, Position, Radians
from kedge.core.registry import sensors
from kedge.core.rotations import direction, wrap


class Measurement(NamedTuple):
    offset: Position
    """Where the landmark is, forward and left of the vehicle."""
    orientation: Heading
    """How the landmark is turned, seen from the vehicle."""


class Unwrapped(NamedTuple):
    offset: Position
    orientation: Annotated[Float[Array, ""], Euclidean("rad")]


class Reads(NamedTuple):
    position: Position
    heading: Heading


class Landmark(NamedTuple):
    position: Position
    heading: Heading


PLACES: Any = np.array([[1.0, 0.0]])  # m
TURNS: Any = np.array([0.0])  # rad


@sensors.add("landmark-pose")
class LandmarkPose(AbstractSensor[Measurement]):
    r"""Position and orientation of a marker in the vehicle's frame.

    $z = [\mathrm{Rot}(-\theta)(l - p),\ \theta_l - \theta] + v$, the angle wrapped.

    One reading determines the pose: $\theta = \theta_l - z_3$, $p = l - \mathrm{Rot}(\theta)
    z_{1,2}$.

    Source: S. Thrun, W. Burgard, D. Fox, "Probabilistic Robotics", 2005, section 6.6.
    """

    reads = Reads
    measures = Measurement
    nominal_rate = 10.0
    target: Landmark = Landmark(PLACES, TURNS)
    offset_std: Metres = 0.05
    orientation_std: Radians = 0.03

    def observe(self, state: Reads) -> Measurement:
        return Measurement(*_seen(self.target, state))

    def noise_std(self, state: Reads) -> Measurement:
        return Measurement(jnp.full(2, self.offset_std), jnp.asarray(self.orientation_std))


@sensors.add("landmark-pose-unwrapped")
class UnwrappedLandmarkPose(AbstractSensor[Unwrapped]):
    r"""The mistake of not wrapping: ``landmark-pose`` with the angle as a plain number.

    Its residual jumps by $2\pi$ where the orientation crosses half a turn. It is here to show
    what that costs, and for nothing else.

    Source: ``landmark-pose``, with the error.
    """

    reads = Reads
    measures = Unwrapped
    nominal_rate = 10.0
    target: Landmark = Landmark(PLACES, TURNS)
    offset_std: Metres = 0.05
    orientation_std: Radians = 0.03

    def observe(self, state: Reads) -> Unwrapped:
        return Unwrapped(*_seen(self.target, state))

    def noise_std(self, state: Reads) -> Unwrapped:
        return Unwrapped(jnp.full(2, self.offset_std), jnp.asarray(self.orientation_std))


def _seen(landmark: Landmark, state: Reads) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    away = landmark.position - state.position
    ahead, left = direction(state.heading), direction(state.heading + jnp.pi / 2)
    return jnp.stack([ahead @ away, left @ away]), wrap(landmark.heading - state.heading)

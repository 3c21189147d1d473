"""The pose of a vehicle in the plane, from a localiser that finds it as a whole."""

from typing import NamedTuple

import jax.numpy as jnp

from kedge.core.contracts import AbstractSensor
from kedge.core.quantities import Heading, Metres, Position, Radians
from kedge.core.registry import sensors


class Pose(NamedTuple):
    position: Position
    heading: Heading


@sensors.add("pose")
class PlanarPose(AbstractSensor[Pose]):
    r"""Position and heading in the map: AMCL, scan matching, a camera on the ceiling.

    $z = [p,\ \psi] + v$, the angle wrapped. Localisers tell a covariance with each pose, which
    a rig takes by the key ``covariance``. Errors of successive poses are seldom independent:
    neighbouring scans share what the map has wrong.

    Source: S. Thrun, W. Burgard, D. Fox, "Probabilistic Robotics", 2005, sections 6.4 and 8.3.
    """

    reads = Pose
    measures = Pose
    nominal_rate = 2.0
    position_std: Metres = 0.05
    heading_std: Radians = 0.02

    def observe(self, state: Pose) -> Pose:
        return state

    def noise_std(self, state: Pose) -> Pose:
        return Pose(jnp.full(2, self.position_std), jnp.asarray(self.heading_std))

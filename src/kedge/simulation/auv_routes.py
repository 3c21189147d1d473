"""Routes of surveys."""

import math

import equinox as eqx

from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar, Speed
from kedge.core.registry import routes
from kedge.simulation.routes import AbstractRoute, Arcs, Place


@routes.add("lawn-mower")
class LawnMower(AbstractRoute):
    """Parallel legs to the east and back, each to the north of the one before.

    Half circles join them. After the last leg it goes on in a straight line.
    """

    leg: float = eqx.field(static=True, default=60.0)  # m
    spacing: float = eqx.field(static=True, default=25.0)  # m
    legs: int = eqx.field(static=True, default=4)
    speed: Speed = 1.5

    def __check_init__(self):
        for name in ("leg", "spacing", "legs"):
            if not getattr(self, name) > 0:
                raise ContractError(f"route: {name} is {getattr(self, name)}, expected above 0")

    def at(self, time: Scalar) -> Place:
        bend, curvatures, lengths = 2 / self.spacing, [], []
        for number in range(self.legs):
            curvatures += [0.0, bend if number % 2 == 0 else -bend]
            lengths += [self.leg, math.pi / bend]
        # The last leg has no end.
        lengths[-2:], curvatures = [1e9], curvatures[:-1]
        return Arcs((0.0, 0.0), 0.0, tuple(curvatures), tuple(lengths), self.speed).at(time)

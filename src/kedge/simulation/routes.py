"""Routes: where something ought to be, as pure functions of time with parameters as fields."""

import abc
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.errors import ContractError
from kedge.core.quantities import Curvature, Metres, Scalar, Seconds, Speed
from kedge.core.registry import routes, unknown
from kedge.core.rotations import direction

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


class Place(NamedTuple):
    """A point of a route."""

    position: Float[Array, "2"]  # m
    velocity: Float[Array, "2"]  # m/s
    heading: Float[Array, ""]  # rad
    yaw_rate: Float[Array, ""]  # rad/s


class AbstractRoute(eqx.Module):
    """Where something ought to be at a time; ``jax.vmap`` gives many times at once."""

    @abc.abstractmethod
    def at(self, time: Scalar) -> Place:
        """The place at ``time`` seconds; at a sharp corner, with the direction after it."""


@routes.add("waypoints")
class Waypoints(AbstractRoute):
    r"""Straight from point to point at constant speed, or with stops at the points.

    With a finite ``acceleration`` each side is a trapezoid of speed: $s = \tfrac12 a \tau^2$
    until the speed v is reached, and the same backwards before the end; it takes
    $L / v + v / a$. A list that ends where it begins is driven again and again; another one
    ends in standing at the last point.

    Raises:
        ContractError: fewer than two points, a side without length, or one that is too short
            to reach the speed.
    """

    points: tuple[tuple[float, float], ...] = eqx.field(static=True)  # m
    speed: Speed = 1.0
    acceleration: float = eqx.field(static=True, default=math.inf)  # m/s^2

    def __check_init__(self):
        if np.shape(self.points)[1:] != (2,) or len(self.points) < 2:
            raise ContractError(
                f"route: points has the shape {np.shape(self.points)}, expected two or more "
                "points of 2 coordinates"
            )
        shortest, least = self.lengths.min(), 0.0
        if isinstance(self.speed, float | int):
            if self.speed <= 0:
                raise ContractError(f"route: speed is {self.speed:g} m/s, expected above 0")
            least = self.speed**2 / self.acceleration
        if not shortest > 0 or shortest < least:
            raise ContractError(
                f"route: the shortest side has {shortest:g} m, expected more than 0 and at "
                f"least {least:g} m, to reach the speed and stop again"
            )

    @property
    def lengths(self) -> Float[np.ndarray, " n"]:
        """Of the sides."""
        return np.linalg.norm(np.diff(self.points, axis=0), axis=1)

    def at(self, time: Scalar) -> Place:
        corners, speed = np.asarray(self.points), jnp.asarray(self.speed)
        lengths, ramp = jnp.asarray(self.lengths), speed / self.acceleration
        ends = jnp.cumsum(lengths / speed + ramp)
        closed = self.points[0] == self.points[-1]
        time = time % ends[-1] if closed else jnp.minimum(time, ends[-1])
        side = jnp.minimum(jnp.searchsorted(ends, time, side="right"), len(lengths) - 1)
        since = time - jnp.where(side > 0, ends[side - 1], 0.0)
        remaining = ends[side] - time
        standing = False if closed else remaining <= 0

        # The side in three parts: speeding up, cruising, slowing down.
        if math.isinf(self.acceleration):
            way, pace = speed * since, speed
        else:
            half, a = jnp.minimum(since, remaining), self.acceleration
            edge = jnp.where(half < ramp, a / 2 * half**2, speed * (half - ramp / 2))
            way = jnp.where(since < remaining, edge, lengths[side] - edge)
            pace = jnp.minimum(a * half, speed)
        pace = jnp.where(standing, 0.0, pace)
        ways = (corners[1:] - corners[:-1]) / self.lengths[:, None]
        along = jnp.asarray(ways)[side]
        heading = jnp.arctan2(along[1], along[0])
        position = jnp.asarray(corners)[side] + way * along
        return Place(position, pace * along, heading, jnp.zeros(()))


@routes.add("arcs")
class Arcs(AbstractRoute):
    r"""Pieces of constant curvature at constant speed, one after the other, again and again.

    From a pose with heading $\psi$ along a length s: the chord has the direction
    $\psi + \kappa s / 2$ and the length $s\,\mathrm{sinc}(\kappa s / 2)$, also for
    $\kappa = 0$.
    """

    start: tuple[float, float] = eqx.field(static=True)  # m
    heading: float = eqx.field(static=True)  # rad
    curvatures: tuple[float, ...] = eqx.field(static=True)  # rad/m
    lengths: tuple[float, ...] = eqx.field(static=True)  # m
    speed: Speed = 1.0

    def __check_init__(self):
        if len(self.curvatures) != len(self.lengths) or not all(s > 0 for s in self.lengths):
            raise ContractError(
                f"route: curvatures {self.curvatures} and lengths {self.lengths}; expected as "
                "many of one as of the other, and lengths above 0"
            )

    def at(self, time: Scalar) -> Place:
        curvatures, lengths = np.asarray(self.curvatures), np.asarray(self.lengths)
        turns = self.heading + np.cumsum(np.append(0.0, curvatures * lengths))
        chords = np.stack(
            [
                _chord(turn, curvature, length)
                for turn, curvature, length in zip(turns, curvatures, lengths, strict=False)
            ]
        )
        origins = np.asarray(self.start) + np.cumsum(np.vstack([np.zeros(2), chords]), axis=0)
        ends = np.cumsum(lengths)
        way = (self.speed * time) % ends[-1]
        piece = jnp.minimum(jnp.searchsorted(ends, way, side="right"), len(ends) - 1)
        way = way - jnp.asarray(np.append(0.0, ends))[piece]
        curvature, turn = jnp.asarray(curvatures)[piece], jnp.asarray(turns)[piece]
        middle = turn + curvature * way / 2
        chord = way * jnp.sinc(curvature * way / (2 * jnp.pi))
        heading = turn + curvature * way
        return Place(
            jnp.asarray(origins)[piece] + chord * direction(middle),
            self.speed * direction(heading),
            heading,
            curvature * self.speed,
        )


@routes.add("circle")
class Circle(AbstractRoute):
    """Counter-clockwise around a centre, from the point at the angle ``phase``."""

    centre: tuple[float, float] = eqx.field(static=True, default=(0.0, 0.0))  # m
    radius: Metres = 1.0
    period: Seconds = 40.0
    phase: float = math.pi  # rad

    def at(self, time: Scalar) -> Place:
        rate = 2 * jnp.pi / jnp.asarray(self.period)
        angle = self.phase + rate * time
        velocity = rate * self.radius * direction(angle + jnp.pi / 2)
        place = jnp.asarray(self.centre) + self.radius * direction(angle)
        return Place(place, velocity, angle + jnp.pi / 2, rate)


@routes.add("figure-of-eight")
class FigureOfEight(AbstractRoute):
    r"""Gerono's lemniscate $p = A \sin\varphi\,[1, \cos\varphi]$, $\varphi = 2\pi t / T$.

    It crosses itself in the origin.
    """

    size: Metres = 5.0
    period: Seconds = 40.0

    def at(self, time: Scalar) -> Place:
        def position(time: Scalar) -> Float[Array, "2"]:
            phase = 2 * jnp.pi * time / self.period
            return self.size * jnp.stack([jnp.sin(phase), jnp.sin(2 * phase) / 2])

        def velocity(time: Scalar) -> Float[Array, "2"]:
            return jax.jvp(position, (time,), (jnp.ones_like(time),))[1]

        time = jnp.asarray(time, float)
        speed, change = jax.jvp(velocity, (time,), (jnp.ones_like(time),))
        turning = (speed[0] * change[1] - speed[1] * change[0]) / (speed @ speed)
        return Place(position(time), speed, jnp.arctan2(speed[1], speed[0]), turning)


@routes.add("lane")
class Lane(AbstractRoute):
    r"""A straight, a clothoid into a curve, the curve, a clothoid out of it, and a straight.

    The curvature is a trapezoid in time: whole from ``begin`` to ``end``, with a ``ramp``
    before and another after. The heading is its integral, exactly, and the position that of
    the heading's direction by Gauss's rule with 8 points for each of the five pieces.

    Source: R. Rajamani, "Vehicle Dynamics and Control", 2nd ed., 2012, section 2.5 (curvature
    as the input of the lateral error dynamics).
    """

    curvature: Curvature = 1 / 800
    begin: Seconds = 11.0
    end: Seconds = 18.0
    ramp: Seconds = 1.0
    speed: Speed = 40.0

    def bend(self, time: Scalar) -> Curvature:
        """The curvature at a time."""
        return self.curvature * jnp.interp(jnp.asarray(time), self._knots(), _TRAPEZOID)

    def at(self, time: Scalar) -> Place:
        knots = self._knots()
        edges = jnp.concatenate([jnp.zeros(1), knots, jnp.full(1, jnp.inf)])
        edges = jnp.minimum(edges, jnp.asarray(time))
        half, middle = jnp.diff(edges) / 2, (edges[1:] + edges[:-1]) / 2
        instants = middle[:, None] + half[:, None] * NODES[None]
        ways = jax.vmap(direction)(jax.vmap(self._heading)(instants.ravel()))
        share = (half[:, None] * WEIGHTS[None]).ravel()
        heading = self._heading(time)
        speed = jnp.asarray(self.speed)
        turning = self.bend(time) * speed
        return Place(speed * (share @ ways), speed * direction(heading), heading, turning)

    def _knots(self) -> Float[Array, "4"]:
        begin, end = jnp.asarray(self.begin), jnp.asarray(self.end)
        return jnp.stack([begin - self.ramp, begin, end, end + self.ramp])

    def _heading(self, time: Scalar) -> Float[Array, ""]:
        """The integral of the trapezoid: exact by the middle of each piece, as it is linear."""
        edges = jnp.minimum(self._knots(), jnp.asarray(time))
        middles = jnp.interp((edges[1:] + edges[:-1]) / 2, self._knots(), _TRAPEZOID)
        return self.curvature * self.speed * jnp.sum(jnp.diff(edges) * middles)


class Facing(AbstractRoute):
    """Another route's places, with the heading towards a point, whatever the direction."""

    route: AbstractRoute
    point: tuple[float, float] = eqx.field(static=True)  # m

    def at(self, time: Scalar) -> Place:
        place = self.route.at(time)
        away = jnp.asarray(self.point) - place.position
        velocity = place.velocity
        turning = (away[1] * velocity[0] - away[0] * velocity[1]) / (away @ away)
        return place._replace(heading=jnp.arctan2(away[1], away[0]), yaw_rate=turning)


_TRAPEZOID: Any = np.array([0.0, 1.0, 1.0, 0.0])
PROFILES = ("trapezoid", "sharp", "fillet")


@routes.add("rectangle")
class Rectangle(AbstractRoute):
    r"""A rectangle, counter-clockwise from the origin, in ``lap`` seconds, again and again.

    "trapezoid" stops at the corners; its speed solves $P / v + 4 v / a = T$ for the perimeter
    P. "sharp" keeps its speed and turns at once. "fillet" rounds the corners, keeps its speed
    and begins where the first side becomes straight.

    Raises:
        ContractError: the profile is unknown, or cannot be driven in that time.
    """

    width: float = eqx.field(static=True, default=20.0)  # m
    height: float = eqx.field(static=True, default=10.0)  # m
    lap: float = eqx.field(static=True, default=100.0)  # s
    profile: str = eqx.field(static=True, default="trapezoid")
    acceleration: float = eqx.field(static=True, default=0.3)  # m/s^2
    radius: float = eqx.field(static=True, default=1.0)  # m

    def __check_init__(self):
        self.driven()

    def at(self, time: Scalar) -> Place:
        return self.driven().at(time)

    def driven(self) -> AbstractRoute:
        """The waypoints or arcs that it is made of."""
        if self.profile not in PROFILES:
            raise ContractError(f"route: {unknown('profile', self.profile, list(PROFILES))}")
        width, height, lap = self.width, self.height, self.lap
        perimeter = 2 * (width + height)
        corners = ((0.0, 0.0), (width, 0.0), (width, height), (0.0, height), (0.0, 0.0))
        if self.profile == "sharp":
            return Waypoints(corners, perimeter / lap)
        if self.profile == "trapezoid":
            slack = lap**2 - 16 * perimeter / self.acceleration
            if slack < 0:
                raise ContractError(
                    f"route: no speed takes {lap:g} s for {perimeter:g} m with four stops at "
                    f"{self.acceleration:g} m/s^2; expected at least "
                    f"{4 * math.sqrt(perimeter / self.acceleration):.4g} s"
                )
            speed = (lap - math.sqrt(slack)) * self.acceleration / 8
            return Waypoints(corners, speed, self.acceleration)
        radius = self.radius
        if not 0 < radius < min(width, height) / 2:
            raise ContractError(
                f"route: radius is {radius:g} m, expected above 0 and below half a side, "
                f"{min(width, height) / 2:g} m"
            )
        sides = (width - 2 * radius, height - 2 * radius) * 2
        quarter = math.pi / 2 * radius
        lengths = tuple(length for side in sides for length in (side, quarter))
        return Arcs((radius, 0.0), 0.0, (0.0, 1 / radius) * 4, lengths, sum(lengths) / lap)


def _chord(heading: float, curvature: float, length: float) -> Float[np.ndarray, "2"]:
    middle = heading + curvature * length / 2
    chord = length * np.sinc(curvature * length / (2 * np.pi))
    return chord * np.array([np.cos(middle), np.sin(middle)])

"""The ellipsoid WGS 84: its radii, its gravity, and metres in place of latitude and longitude.

Inside kedge a position on the ellipsoid is three lengths from an origin in the east, the north
and up, each in proportion to longitude, latitude and height. They keep what 64 bits resolve (a
few nanometres), and their differences are metres. They are no Cartesian coordinates: a metre of
``east`` is a metre on the ground at the latitude of the origin only.

Source: P. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation
Systems", 2nd ed., 2013, section 2.4.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from kedge.core.quantities import Metres, Radians, Scalar

EQUATOR = 6378137.0  # m, semi-major axis
FLATTENING = 1 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)
EARTH_RATE = 7.292115e-5  # rad/s


class Radii(NamedTuple):
    """Of curvature, in m."""

    meridian: Float[Array, ""]
    transverse: Float[Array, ""]


def radii(latitude: Radians) -> Radii:
    r"""$R_M = a (1 - e^2) / (1 - e^2 \sin^2 L)^{3/2}$, $R_N = a / \sqrt{1 - e^2 \sin^2 L}$."""
    squared = 1 - ECCENTRICITY_SQUARED * jnp.sin(latitude) ** 2
    return Radii(
        EQUATOR * (1 - ECCENTRICITY_SQUARED) / squared**1.5, EQUATOR / jnp.sqrt(squared)
    )


def gravity(latitude: Radians, height: Metres) -> Float[Array, ""]:
    """Somigliana's formula on the ellipsoid, and the free-air gradient above it, in m/s^2."""
    squared = jnp.sin(latitude) ** 2
    ground = 9.7803253359 * (1 + 0.00193185265241 * squared)
    ground = ground / jnp.sqrt(1 - ECCENTRICITY_SQUARED * squared)
    return ground * (1 - 2 * height / EQUATOR)


def earth_spin(latitude: Radians) -> Float[Array, "3"]:
    """The rotation of the earth in axes to the east, the north and up, in rad/s."""
    zero = jnp.zeros_like(jnp.asarray(latitude, float))
    return EARTH_RATE * jnp.stack([zero, jnp.cos(latitude), jnp.sin(latitude)])


class Origin(NamedTuple):
    """Where the map's origin lies on the ellipsoid."""

    latitude: Radians
    longitude: Radians = 0.0
    height: Metres = 0.0

    def scales(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Metres of the map for a radian of longitude, and of latitude."""
        meridian, transverse = radii(self.latitude)
        east = (transverse + self.height) * jnp.cos(self.latitude)
        return east, meridian + self.height

    def to_map(self, latitude: Scalar, longitude: Scalar, height: Scalar) -> Float[Array, "3"]:
        """East, north and up of a place."""
        east, north = self.scales()
        return jnp.stack(
            [
                east * (longitude - self.longitude),
                north * (latitude - self.latitude),
                jnp.asarray(height - self.height),
            ]
        )

    def from_map(
        self, position: Float[Array, "3"]
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        """Latitude, longitude and height of a place on the map."""
        east, north = self.scales()
        return (
            self.latitude + position[1] / north,
            self.longitude + position[0] / east,
            self.height + position[2],
        )

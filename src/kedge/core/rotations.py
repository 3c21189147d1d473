"""Unit quaternions (w, x, y, z): the algebra behind the chart of an attitude."""

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

if TYPE_CHECKING:
    Scalar = float | Array
else:
    Scalar = Float[ArrayLike, ""]


_MATRIX = np.zeros((3, 3, 4, 4))
"""Entries of the rotation matrix by the products of two components of the quaternion."""
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _MATRIX[_i, _i] = -np.eye(4)
    _MATRIX[_i, _i, 0, 0] = _MATRIX[_i, _i, _i + 1, _i + 1] = 1
    _MATRIX[_i, _j, _i + 1, _j + 1] = _MATRIX[_j, _i, _i + 1, _j + 1] = 2
    _MATRIX[_i, _j, 0, _k + 1], _MATRIX[_j, _i, 0, _k + 1] = -2, 2
_SPIN = np.zeros((4, 4, 3))
"""Entries of q -> q w / 2 by the components of w."""
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _SPIN[0, _i + 1, _i], _SPIN[_i + 1, 0, _i] = -0.5, 0.5
    _SPIN[_i + 1, _j + 1, _k], _SPIN[_i + 1, _k + 1, _j] = 0.5, -0.5


def multiply(p: Float[Array, "4"], q: Float[Array, "4"]) -> Float[Array, "4"]:
    """Hamilton product."""
    pw, pv, qw, qv = p[0], p[1:], q[0], q[1:]
    return jnp.concatenate([(pw * qw - pv @ qv)[None], pw * qv + qw * pv + jnp.cross(pv, qv)])


def conjugate(q: Float[Array, "4"]) -> Float[Array, "4"]:
    """Inverse of a unit quaternion."""
    return jnp.concatenate([q[:1], -q[1:]])


def exp(rotation_vector: Float[Array, "3"]) -> Float[Array, "4"]:
    """Unit quaternion of a rotation vector in rad."""
    squared = rotation_vector @ rotation_vector
    small = squared < 1e-12
    half = jnp.sqrt(jnp.where(small, 1.0, squared)) / 2
    ratio = jnp.where(small, 0.5 - squared / 48, jnp.sin(half) / (2 * half))
    real = jnp.where(small, 1 - squared / 8, jnp.cos(half))
    return jnp.concatenate([real[None], ratio * rotation_vector])


def exp_slope(rotation_vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    r"""The right Jacobian: $\exp(v + \epsilon) = \exp(v) \exp(J \epsilon)$ to first order.

    $J = I - \frac{1 - \cos\theta}{\theta^2} [v]_\times + \frac{\theta - \sin\theta}{\theta^3}
    [v]_\times^2$ with $\theta = \lVert v \rVert$.

    Source: J. Solà, "Quaternion kinematics for the error-state Kalman filter", 2017,
    arXiv 1711.02508, section 4.3.4, equation 183.
    """
    x, y, z = rotation_vector[0], rotation_vector[1], rotation_vector[2]
    squared = rotation_vector @ rotation_vector
    small = squared < 1e-6
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    once = jnp.where(small, 0.5 - squared / 24, (1 - jnp.cos(angle)) / safe)
    twice = jnp.where(small, 1 / 6 - squared / 120, (angle - jnp.sin(angle)) / (safe * angle))
    cross = jnp.stack([0.0 * x, -z, y, z, 0.0 * x, -x, -y, x, 0.0 * x]).reshape(3, 3)
    outer = rotation_vector[:, None] * rotation_vector[None]
    return (1 - twice * squared) * jnp.eye(3) - once * cross + twice * outer


def log(q: Float[Array, "4"]) -> Float[Array, "3"]:
    """Rotation vector in rad, of length at most pi, of a unit quaternion."""
    q = jnp.where(q[0] < 0, -q, q)
    squared = q[1:] @ q[1:]
    small = squared < 1e-12
    norm = jnp.sqrt(jnp.where(small, 1.0, squared))
    ratio = jnp.where(small, 2 / q[0], 2 * jnp.arctan2(norm, q[0]) / norm)
    return ratio * q[1:]


def rotate(q: Float[Array, "4"], vector: Float[Array, "3"]) -> Float[Array, "3"]:
    """Express a body-frame vector in the map frame."""
    twice = 2 * jnp.cross(q[1:], vector)
    return vector + q[0] * twice + jnp.cross(q[1:], twice)


def matrix_of(q: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Rotation matrix of a quaternion, times its squared length."""
    products = jnp.ravel(q[:, None] * q[None])
    return jnp.dot(_MATRIX.reshape(9, 16), products).reshape(3, 3)


def spun(q: Float[Array, "4"], rate: Float[Array, "3"]) -> Float[Array, "4"]:
    r"""$\dot q = \tfrac12 q \otimes \omega$ for a rate in the body in rad/s."""
    products = jnp.ravel(q[:, None] * rate[None])
    return jnp.dot(_SPIN.reshape(4, 12), products)


def wrap(angle: Scalar) -> Float[Array, ""]:
    """Wrap an angle in rad to [-pi, pi).

    By floor and not by a remainder: that is a library call for each number, and the slowest
    part of a batched prediction.
    """
    turn = 2 * jnp.pi
    wrapped = angle - turn * jnp.floor((angle + jnp.pi) / turn)
    # Within rounding of the seam the floor may be one off.
    wrapped = jnp.where(wrapped < jnp.pi, wrapped, wrapped - turn)
    return jnp.where(wrapped < -jnp.pi, wrapped + turn, wrapped)


def direction(heading: Scalar) -> Float[Array, "2"]:
    """Unit vector at ``heading`` rad, counter-clockwise from the first axis."""
    return jnp.stack([jnp.cos(heading), jnp.sin(heading)])


def polar(offset: Float[Array, "2"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Length in m and direction in rad of a plane vector; its derivatives are finite at 0."""
    at_origin = (jnp.abs(offset) < 1e-9).all()
    x, y = jnp.where(at_origin, jnp.array([1e-9, 0.0]), offset)
    return jnp.hypot(x, y), jnp.arctan2(y, x)

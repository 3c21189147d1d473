"""The forces on a torpedo-shaped hull with four fins, and its mass with that of the water.

Everything here is in the frames of the source: forward, starboard, down, with the origin in the
centre of buoyancy.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from kedge.core.errors import ContractError
from kedge.core.quantities import Scalar
from kedge.numerics.linalg import cholesky, gain

GRAVITY = 9.81  # m/s^2


FORCES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
FEATURES = (
    *(first + second for first in "uvwpqr" for second in "uvwpqr"),
    *(f"{axis}|{axis}|" for axis in "uvwpqr"),
    *("down_x", "down_y", "down_z", "thrust", "roll_torque", "uu rudder", "uu stern"),
)
"""Products of two of the velocities (as an outer product, each pair twice), signed squares, and
what does not depend on them in second degree."""


class Coefficients(eqx.Module):
    """A hull: its rigid body, and how the water answers to each motion.

    The names are those of the source, with ``dot`` for an acceleration: ``Yvdot`` is the sway
    force by the sway acceleration (an added mass, negative), ``Yuudr`` that of the rudder by
    the squared speed and the angle. SI units, rad.

    Raises:
        ContractError: the mass matrix is not symmetric or not positive definite, a weight is
            not above 0, or fins do not turn at all.

    Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
    REMUS autonomous underwater vehicle", 2001, chapters 2 to 4.
    """

    weight: Scalar  # N
    buoyancy: Scalar  # N
    xG: Scalar  # m, centre of gravity
    yG: Scalar
    zG: Scalar
    xB: Scalar  # m, centre of buoyancy
    yB: Scalar
    zB: Scalar
    Ixx: Scalar  # kg m^2
    Iyy: Scalar
    Izz: Scalar
    Xprop: Scalar  # N, in a steady cruise
    Kprop: Scalar  # N m
    fin_limit: Scalar  # rad
    Xuu: Scalar
    Xudot: Scalar
    Xwq: Scalar
    Xqq: Scalar
    Xvr: Scalar
    Xrr: Scalar
    Yvv: Scalar
    Yrr: Scalar
    Yuv: Scalar
    Yvdot: Scalar
    Yrdot: Scalar
    Yur: Scalar
    Ywp: Scalar
    Ypq: Scalar
    Yuudr: Scalar
    Zww: Scalar
    Zqq: Scalar
    Zuw: Scalar
    Zwdot: Scalar
    Zqdot: Scalar
    Zuq: Scalar
    Zvp: Scalar
    Zrp: Scalar
    Zuuds: Scalar
    Kpp: Scalar
    Kpdot: Scalar
    Mww: Scalar
    Mqq: Scalar
    Muw: Scalar
    Mwdot: Scalar
    Mqdot: Scalar
    Muq: Scalar
    Mvp: Scalar
    Mrp: Scalar
    Muuds: Scalar
    Nvv: Scalar
    Nrr: Scalar
    Nuv: Scalar
    Nvdot: Scalar
    Nrdot: Scalar
    Nur: Scalar
    Nwp: Scalar
    Npq: Scalar
    Nuudr: Scalar

    def __check_init__(self):
        if not all(isinstance(v, float | int) for v in self.values().values()):
            return  # arrays: a sweep, which no message could name a value of
        for name in ("weight", "fin_limit"):
            if not getattr(self, name) > 0:
                raise ContractError(f"{name} is {getattr(self, name)}, expected above 0")
        for one, other in (("Zqdot", "Mwdot"), ("Yrdot", "Nvdot")):
            if not np.isclose(getattr(self, one), getattr(self, other), rtol=1e-6, atol=1e-9):
                raise ContractError(
                    f"{one} is {getattr(self, one):g} and {other} {getattr(self, other):g}, "
                    "expected one value: the mass matrix is symmetric"
                )
        with jax.ensure_compile_time_eval():  # plain numbers, even if somebody is tracing
            least = float(np.linalg.eigvalsh(np.asarray(self.mass()))[0])
        if not least > 0:
            raise ContractError(
                f"the mass matrix is not positive definite: found the eigenvalue {least:.6g}, "
                "expected all above 0; added masses (Xudot, Yvdot, Zwdot, Kpdot, Mqdot, Nrdot) "
                "are negative"
            )

    def values(self) -> dict[str, Any]:
        """The coefficients by name."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    def changed(self, **values: Scalar) -> "Coefficients":
        """The same hull with other values of some coefficients."""
        return dataclasses.replace(self, **values)

    def mass(self) -> Float[Array, "6 6"]:
        """Mass and inertia, of the body and of the water that it takes along."""
        m = self.weight / GRAVITY
        x, y, z = m * self.xG, m * self.yG, m * self.zG
        rows = (
            (m - self.Xudot, 0, 0, 0, z, -y),
            (0, m - self.Yvdot, 0, -z, 0, x - self.Yrdot),
            (0, 0, m - self.Zwdot, y, -x - self.Zqdot, 0),
            (0, -z, y, self.Ixx - self.Kpdot, 0, 0),
            (z, 0, -x - self.Mwdot, 0, self.Iyy - self.Mqdot, 0),
            (-y, x - self.Nvdot, 0, 0, 0, self.Izz - self.Nrdot),
        )
        return jnp.stack([jnp.stack([jnp.asarray(v, float) for v in row]) for row in rows])

    def compliance(self) -> Float[Array, "6 6"]:
        """The inverse of the mass matrix."""
        return gain(jnp.eye(6), cholesky(self.mass()))


def terms(hull: Coefficients) -> dict[str, dict[str, Scalar]]:
    r"""The equations of motion: by force, what each feature is multiplied by.

    The rigid body's centripetal and gyroscopic terms, added mass, drag, lift of body and fins,
    propulsion, and weight and buoyancy: $r_G \times f_G - r_B \times f_B$ for the moments.

    Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
    REMUS autonomous underwater vehicle", 2001, equations 4.3 and 5.1 to 5.5; the signs of the
    moments of weight and buoyancy are those of the cross products, where the thesis slips.
    """
    c = hull
    m = c.weight / GRAVITY
    x, y, z = m * c.xG, m * c.yG, m * c.zG
    net = c.weight - c.buoyancy
    arm_x = c.xG * c.weight - c.xB * c.buoyancy
    arm_y = c.yG * c.weight - c.yB * c.buoyancy
    arm_z = c.zG * c.weight - c.zB * c.buoyancy
    surge = {"u|u|": c.Xuu, "wq": c.Xwq - m, "qq": c.Xqq + x, "vr": c.Xvr + m}
    surge |= {"rr": c.Xrr + x, "pq": -y, "pr": -z, "down_x": net, "thrust": 1.0}
    sway = {"v|v|": c.Yvv, "r|r|": c.Yrr, "rr": y, "pp": y, "ur": c.Yur - m}
    sway |= {"wp": c.Ywp + m, "pq": c.Ypq - x, "uv": c.Yuv, "qr": -z, "uu rudder": c.Yuudr}
    sway |= {"down_y": net}
    heave = {"w|w|": c.Zww, "q|q|": c.Zqq, "uq": c.Zuq + m, "vp": c.Zvp - m}
    heave |= {"pr": c.Zrp - x, "uw": c.Zuw, "pp": z, "qq": z, "qr": -y, "uu stern": c.Zuuds}
    heave |= {"down_z": net}
    roll = {"p|p|": c.Kpp, "qr": c.Iyy - c.Izz, "uq": y, "vp": -y, "wp": -z, "ur": z}
    roll |= {"down_z": arm_y, "down_y": -arm_z, "roll_torque": 1.0}
    pitch = {"w|w|": c.Mww, "q|q|": c.Mqq, "uq": c.Muq - x, "vp": c.Mvp + x, "uw": c.Muw}
    pitch |= {"pr": c.Mrp + c.Izz - c.Ixx, "vr": z, "wq": -z, "uu stern": c.Muuds}
    pitch |= {"down_x": arm_z, "down_z": -arm_x}
    yaw = {"v|v|": c.Nvv, "r|r|": c.Nrr, "ur": c.Nur - x, "wp": c.Nwp + x, "uv": c.Nuv}
    yaw |= {"pq": c.Npq + c.Ixx - c.Iyy, "vr": -y, "wq": y, "uu rudder": c.Nuudr}
    yaw |= {"down_y": arm_x, "down_x": -arm_y}
    return dict(zip(FORCES, (surge, sway, heave, roll, pitch, yaw), strict=True))


def response(hull: Coefficients, drag_scale: Scalar = 1.0) -> Float[Array, "6 f"]:
    """What each feature does to the accelerations: the mass matrix's inverse times the terms.

    ``drag_scale`` is how much of the axial drag there is.
    """
    table = terms(hull)
    table["surge"]["u|u|"] = drag_scale * table["surge"]["u|u|"]
    entries = [
        (FORCES.index(force), FEATURES.index(name), jnp.asarray(value, float))
        for force, row in table.items()
        for name, value in row.items()
    ]
    rows, columns, values = zip(*entries, strict=True)
    empty = jnp.zeros((6, len(FEATURES)))
    whole = empty.at[np.array(rows), np.array(columns)].set(jnp.stack(values))
    return hull.compliance() @ whole


def features(
    velocity: Float[Array, "6"], down: Float[Array, "3"], commands: Float[Array, "4"]
) -> Float[Array, " f"]:
    """What the forces are linear in.

    Args:
        velocity: u, v, w (m/s, through the water), p, q, r (rad/s).
        down: the unit vector of gravity, in the body.
        commands: thrust (N), roll torque (N m), rudder and stern plane (rad).
    """
    products = jnp.ravel(velocity[:, None] * velocity[None])
    fins = velocity[0] ** 2 * commands[2:]
    signed = velocity * jnp.abs(velocity)
    return jnp.concatenate([products, signed, down, commands[:2], fins])


Features = Callable[
    [Float[Array, "6"], Float[Array, "3"], Float[Array, "4"]], Float[Array, " f"]
]


def tangent_features(hull: Coefficients) -> Features:
    r"""What :func:`features` is to first order about straight and level travel at the cruise.

    $\phi(x_0) + \partial\phi / \partial x\,(x - x_0)$ with $u_0 = \sqrt{X_{prop} / -X_{uu}}$.

    Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
    REMUS autonomous underwater vehicle", 2001, chapter 8 (linearised vehicle model).
    """
    drag = -jnp.asarray(hull.Xuu)
    speed = jnp.sqrt(jnp.maximum(hull.Xprop / jnp.where(drag > 0, drag, jnp.inf), 0.0))
    thrust = jnp.zeros(4).at[:2].set(jnp.stack([1.0 * hull.Xprop, 1.0 * hull.Kprop]))
    about = jnp.zeros(6).at[0].set(speed), jnp.array([0.0, 0.0, 1.0]), thrust

    def form(*given: Array) -> Float[Array, " f"]:
        apart = tuple(x - at for x, at in zip(given, about, strict=True))
        value, change = jax.jvp(features, about, apart)
        return value + change

    return form


def conservative(hull: Coefficients) -> Coefficients:
    r"""The hull in an ideal fluid: no drag, no lift, no fins; energy is kept.

    What is left are the body's own terms, weight and buoyancy, and the added mass with its
    coupling terms, which follow from it.

    Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
    REMUS autonomous underwater vehicle", 2001, section 4.4 (added mass).
    """
    c = hull
    lost = ("Xuu", "Yvv", "Yrr", "Yuv", "Yuudr", "Zww", "Zqq", "Zuw", "Zuuds", "Kpp")
    lost += ("Mww", "Mqq", "Muuds", "Nvv", "Nrr", "Nuudr", "Xprop", "Kprop")
    return c.changed(
        **dict.fromkeys(lost, 0.0),
        Xwq=c.Zwdot,
        Xqq=c.Zqdot,
        Xvr=-c.Yvdot,
        Xrr=-c.Yrdot,
        Yur=c.Xudot,
        Ywp=-c.Zwdot,
        Ypq=-c.Zqdot,
        Zuq=-c.Xudot,
        Zvp=c.Yvdot,
        Zrp=c.Yrdot,
        Muw=-(c.Zwdot - c.Xudot),
        Mvp=-c.Yrdot,
        Mrp=c.Kpdot - c.Nrdot,
        Muq=-c.Zqdot,
        Nuv=-(c.Xudot - c.Yvdot),
        Nwp=c.Zqdot,
        Npq=-(c.Kpdot - c.Mqdot),
        Nur=c.Yrdot,
    )


def cruise(hull: Coefficients) -> float:
    """The speed in m/s at which thrust is all drag."""
    drag = -float(hull.Xuu)
    return (float(hull.Xprop) / drag) ** 0.5 if drag > 0 and hull.Xprop > 0 else 0.0


def modes(hull: Coefficients, speed: float) -> Complex[np.ndarray, "8"]:
    """The eigenvalues (1/s) about straight and level travel at a speed, fins at rest.

    Of u, v, w, p, q, r and the angles of roll and pitch.
    """
    return np.linalg.eigvals(linearised(hull, speed)[0]).astype(complex)


def linearised(
    hull: Coefficients, speed: float
) -> tuple[Float[np.ndarray, "8 8"], Float[np.ndarray, "8 4"]]:
    r"""A and B of $\delta\dot x = A\,\delta x + B\,\delta u$ about straight and level travel.

    x is u, v, w, p, q, r and the angles of roll and pitch (forward, starboard, down); u is
    thrust, roll torque, rudder and stern plane, all at 0 there.
    """
    A, B = _slopes(hull, jnp.asarray(speed, float))
    return np.asarray(A), np.asarray(B)


@jax.jit
def _slopes(
    hull: Coefficients, speed: Scalar
) -> tuple[Float[Array, "8 8"], Float[Array, "8 4"]]:
    reply = response(hull)

    def rates(x: Float[Array, "8"], commands: Float[Array, "4"]) -> Float[Array, "8"]:
        roll, pitch = x[6], x[7]
        upright = jnp.cos(pitch)
        down = jnp.stack([-jnp.sin(pitch), upright * jnp.sin(roll), upright * jnp.cos(roll)])
        turning = x[3:5] * jnp.stack([1.0, jnp.cos(roll)])
        turning = turning + x[5] * jnp.stack([jnp.tan(pitch), -jnp.sin(roll)])
        return jnp.concatenate([reply @ features(x[:6], down, commands), turning])

    return jax.jacfwd(rates, (0, 1))(jnp.zeros(8).at[0].set(speed), jnp.zeros(4))

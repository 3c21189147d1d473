"""Hydrodynamic coefficients from the shape of a hull and its fins."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kedge.core.errors import ContractError
from kedge.vehicles.underwater.hydrodynamics import Coefficients

SLICES = 20_001
"""Points along the axis at which sections are summed."""
BODY_LIFT = 0.003
"""Lift of the hull by the angle of attack in degrees, for l/d from 6.7 to 10 (Hoerner)."""


class Hull(NamedTuple):
    """A Myring hull: a nose, a cylinder and a tail; the defaults are those of REMUS 100.

    Lengths in m. An offset is what is cut off the tip.
    """

    nose: float = 0.191
    nose_offset: float = 0.0165
    middle: float = 0.654
    tail: float = 0.541
    length: float = 1.33
    diameter: float = 0.191
    nose_power: float = 2.0
    tail_angle: float = 0.436  # rad
    centre: float = 0.611
    """Of buoyancy, from the tip of the nose."""
    axial_drag: float = 0.11
    """Of the frontal area; REMUS's tables have this, its tow tank 0.267."""
    cross_drag: float = 1.1

    def radius(self, behind: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The radius at distances behind the tip of the nose.

        Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
        REMUS autonomous underwater vehicle", 2001, section 2.1 (equations of Myring).
        """
        a, c, d = self.nose, self.tail, self.diameter
        round_off = np.clip(1 - ((behind + self.nose_offset - a) / a) ** 2, 0, None)
        nose = d / 2 * round_off ** (1 / self.nose_power)
        since = behind - (a + self.middle - self.nose_offset)
        slope = math.tan(self.tail_angle)
        quadratic = 1.5 * d / c**2 - slope / c
        tail = d / 2 - quadratic * since**2 + (d / c**3 - slope / c**2) * since**3
        return np.where(behind < a - self.nose_offset, nose, np.where(since < 0, d / 2, tail))


class Fins(NamedTuple):
    """Four equal fins in a cross; the defaults are those of REMUS 100."""

    area: float = 6.65e-3  # m^2, of one
    post: float = -0.638  # m, before the centre of buoyancy
    front: float = -0.611  # m
    back: float = -0.685  # m
    reach: float = 0.131  # m, from the axis
    lift: float = 3.12  # 1/rad
    cross_drag: float = 0.558
    limit: float = 0.23736  # rad


class Load(NamedTuple):
    """The rigid body: N, m, kg m^2; and what drives it at cruise: N, N m."""

    weight: float = 299.0
    buoyancy: float = 306.0
    low: float = 0.0196
    """How far the centre of gravity is below that of buoyancy."""
    roll_inertia: float = 0.177
    pitch_inertia: float = 3.45
    thrust: float = 3.86
    torque: float = -0.543


def coefficients_from_geometry(
    hull: Hull, fins: Fins, load: Load | None = None, density: float = 1030.0
) -> Coefficients:
    r"""Strip theory: added mass and cross-flow drag of every section, lift of hull and fins.

    Added mass: $\pi \rho R^2$ a section, $\pi \rho (a^2 - R^2 + R^4 / a^2)$ where fins reach to
    a, and a spheroid's along the axis. Cross-flow drag: $\rho c_{dc} R$ a section,
    $\tfrac12 \rho S c_{df}$ a fin. Lift: Hoerner's of a streamlined body, acting at 0.65 of its
    length, and $\tfrac12 \rho c_L S$ of a fin. The coupling terms of added mass follow from it.

    With the defaults, and against the tables of the thesis ("remus100-derived"): added masses
    and cross-flow drag within 2 %, Mqq and Nrr 10 %, fins 11 % (0.5 % with an area of 0.0060
    m^2, which must be that of the tables), lift 16 %. What is the small difference of large
    parts (Yrr, Zqq, Muq) or has a lever of its own in the thesis (Kpp) is another number
    altogether, and Mww and Nvv have the other sign: the drag of what lies aft of the centre
    pushes the stern, but the thesis adds its fins the other way round. Trials decide, not this.

    Raises:
        ContractError: the hull is not as long as its parts say, or has no room for its fins.

    Source: T. Prestero, "Verification of a six-degree of freedom simulation model for the
    REMUS autonomous underwater vehicle", 2001, chapter 4, with $|x|^3$ in equation 4.8 as it
    must be; H. Lamb, "Hydrodynamics", 1932, section 114 (the spheroid).
    """
    load = load or Load()
    behind = np.linspace(0.0, hull.length, SLICES)
    R, x = hull.radius(behind), hull.centre - behind
    at_fins = (x >= fins.back) & (x <= fins.front)
    if R.min() < 0 or not at_fins.any() or R[at_fins].max() >= fins.reach:
        raise ContractError(
            f"hull: from {R.min():.3g} m to {R.max():.3g} m of radius along {hull.length:g} m, "
            f"fins from {fins.back:g} to {fins.front:g} m reaching {fins.reach:g} m; expected "
            "radii above 0, and fins behind the middle that reach beyond the hull"
        )

    def along(values: Float[np.ndarray, " n"]) -> float:
        return float(np.trapezoid(values, behind))

    reach = np.where(at_fins, fins.reach, R)
    finned = reach**2 - R**2 + R**4 / np.maximum(reach, 1e-9) ** 2
    section = np.pi * density * np.where(at_fins, finned, R**2)
    heave, tilt, turn = -along(section), along(x * section), -along(x**2 * section)
    spin = -2 / np.pi * density * fins.reach**4 * (fins.front - fins.back)
    ahead = (
        -_spheroid(hull.length / hull.diameter)
        * density
        * np.pi
        / 6
        * (hull.length * hull.diameter**2)
    )

    # Cross-flow drag of the hull, and of two fins whose area lies between front and back.
    skin, two = density * hull.cross_drag * R, density * fins.area * fins.cross_drag
    chord = np.linspace(fins.back, fins.front, 101)
    levers = [float(np.mean(power)) for power in (chord, chord * abs(chord), abs(chord) ** 3)]
    across = -along(skin) - two
    lever = along(x * skin) + two * levers[0]
    bent = along(x * abs(x) * skin) + two * levers[1]
    damped = -along(abs(x) ** 3 * skin) - two * levers[2]
    mean_reach = (fins.reach + float(R[at_fins].mean())) / 2

    frontal = np.pi / 4 * hull.diameter**2
    slope = BODY_LIFT * np.degrees(1.0) * hull.length / hull.diameter
    body = -density / 2 * hull.diameter**2 * slope
    body_lever = body * (0.65 * hull.length - hull.centre)
    fin = density / 2 * fins.lift * fins.area
    fin_lever = fins.post * fin
    muw, muq = -(heave - ahead) + body_lever + fin_lever, -tilt + fins.post * -fin_lever
    return Coefficients(
        **{"weight": load.weight, "buoyancy": load.buoyancy, "zG": load.low},
        **dict.fromkeys(("xG", "yG", "xB", "yB", "zB"), 0.0),
        **{"Ixx": load.roll_inertia, "Iyy": load.pitch_inertia, "Izz": load.pitch_inertia},
        **{"Xprop": load.thrust, "Kprop": load.torque, "fin_limit": fins.limit},
        **{"Xuu": -density / 2 * hull.axial_drag * frontal, "Xudot": ahead},
        **{"Xwq": heave, "Xqq": tilt, "Xvr": -heave, "Xrr": tilt},
        **{"Yvv": across, "Yrr": -bent, "Yuv": body - fin, "Yvdot": heave, "Yrdot": -tilt},
        **{"Yur": ahead - fin_lever, "Ywp": -heave, "Ypq": -tilt, "Yuudr": fin},
        **{"Zww": across, "Zqq": bent, "Zuw": body - fin, "Zwdot": heave, "Zqdot": tilt},
        **{"Zuq": -ahead + fin_lever, "Zvp": heave, "Zrp": -tilt, "Zuuds": -fin},
        **{"Kpp": -2 * two * mean_reach**3, "Kpdot": spin},
        **{"Mww": lever, "Mqq": damped, "Muw": muw, "Mwdot": tilt, "Mqdot": turn, "Muq": muq},
        **{"Mvp": tilt, "Mrp": spin - turn, "Muuds": fin_lever},
        **{"Nvv": -lever, "Nrr": damped, "Nuv": -muw, "Nvdot": -tilt, "Nrdot": turn},
        **{"Nur": muq, "Nwp": tilt, "Npq": turn - spin, "Nuudr": fin_lever},
    )


def _spheroid(slenderness: float) -> float:
    """Added mass of a prolate spheroid along its axis, by its displaced mass."""
    e = math.sqrt(1 - 1 / slenderness**2)
    alpha = 2 * (1 - e**2) / e**3 * (math.atanh(e) - e)
    return alpha / (2 - alpha)

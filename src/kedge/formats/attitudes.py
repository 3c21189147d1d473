"""Attitudes of files as quaternions (w, x, y, z) that turn a forward-left-up body into ENU."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from kedge.core.errors import DataError
from kedge.formats.toml import Strict
from kedge.formats.units import to_enu, unit_of

Quaternions = Float[np.ndarray, "n 4"]
ORDERS = {"wxyz": (0, 1, 2, 3), "xyzw": (3, 0, 1, 2)}
"""Where w, x, y and z stand."""
TOLERANCE = 0.01
"""By how much the length of a quaternion of few digits may differ from 1."""


class AttitudeConfig(Strict):
    """The columns of an attitude: four of a quaternion, or roll, pitch and heading.

    The angles turn as a mount's do: by the heading about z, then by the pitch about the new y,
    then by the roll about the new x, each right-handed in the axes of the source's frame (so
    nose up by the pitch in ``ned``, nose down in ``enu``).
    """

    columns: list[str]
    """Four of a quaternion, or three angles."""
    order: Literal["wxyz", "xyzw", "roll-pitch-heading"]
    """What they are, in order."""
    unit: str = "rad"
    """Of the angles."""
    name: str = "attitude"
    """What the attitude is called inside."""

    def validation_errors(self) -> Iterator[str]:
        """Another number of columns, a unit that is no angle's."""
        count = len(self.order.split("-")) if "-" in self.order else 4
        if len(self.columns) != count:
            yield f"columns: found {len(self.columns)}, expected {count} for {self.order}"
        try:
            angle = unit_of(self.unit)[0] == "rad"
        except DataError:
            angle = False
        if not angle:
            yield f"unit: found {self.unit!r}, expected rad or deg"

    def column_units(self) -> dict[str, str]:
        """By column, its unit."""
        return dict.fromkeys(self.columns, "1" if self.order in ORDERS else self.unit)

    def inside(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> dict[str, np.ndarray]:
        """The columns of the quaternion, by the names that they have inside."""
        values = [columns[name] for name in self.columns]
        if self.order in ORDERS:
            parts = np.stack([values[at] for at in ORDERS[self.order]], axis=1)
        else:
            parts = quaternions(*values)
        return {f"{self.name}_{axis}": parts[:, at] for at, axis in enumerate("wxyz")}


def quaternions(
    roll: Float[np.ndarray, "*n"],
    pitch: Float[np.ndarray, "*n"],
    heading: Float[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n 4"]:
    r"""$q = q_z(\psi)\, q_y(\theta)\, q_x(\varphi)$.

    Source: J. Diebel, "Representing attitude: Euler angles, unit quaternions, and rotation
    vectors", Stanford University, 2006, section 8.2.
    """
    (sr, cr), (sp, cp), (sh, ch) = (
        (np.sin(angle / 2), np.cos(angle / 2)) for angle in (roll, pitch, heading)
    )
    return np.stack(
        [
            ch * cp * cr + sh * sp * sr,
            ch * cp * sr - sh * sp * cr,
            ch * sp * cr + sh * cp * sr,
            sh * cp * cr - ch * sp * sr,
        ],
        axis=-1,
    )


def from_ned(turns: Quaternions) -> Quaternions:
    r"""What turns a forward-right-down body into NED, as what turns forward-left-up into ENU.

    $q_e \otimes q \otimes q_f$ with half a turn $q_e$ about north-east and $q_f$ about forward.
    """
    w, x, y, z = np.moveaxis(turns, -1, 0)
    return np.stack([w + z, x + y, x - y, w - z], axis=-1) / np.sqrt(2)


def no_rotation(turns: Quaternions) -> Bool[np.ndarray, " n"]:
    """Which of them are none, by their length; NaN is a missing one."""
    return np.abs(np.linalg.norm(turns, axis=-1) - 1) > TOLERANCE


def require_rotations(path: Path, lines: np.ndarray, turns: Quaternions, role: str) -> None:
    """Refuse quaternions whose length is not 1.

    Raises:
        DataError: with the line.
    """
    wrong = no_rotation(turns)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise DataError(
            f"{path}:{lines[at]}: {role}: found a quaternion of length "
            f"{np.linalg.norm(turns[at]):.3g}, expected 1"
        )


def all_to_enu(
    path: Path, columns: Mapping[str, np.ndarray], units: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Bring all columns of a NED source to ENU: values and units by their names there.

    Raises:
        DataError: a column is a part of a quaternion whose others are not there.
    """
    names = {name: [f"{name[:-1]}{axis}" for axis in "wxyz"] for name in columns}
    whole = [parts for name, parts in names.items() if name.endswith("_w")]
    whole = [parts for parts in whole if set(parts) <= set(columns)]
    turned: dict[str, np.ndarray] = {}
    for parts in whole:
        turns = from_ned(np.stack([columns[part] for part in parts], axis=-1))
        turned |= dict(zip(parts, turns.T, strict=True))
    inside = {name: (name, values) for name, values in turned.items()} | {
        name: to_enu(path, name, units[name], values)
        for name, values in columns.items()
        if name not in turned
    }
    return dict(inside.values()), {new: units[old] for old, (new, _) in inside.items()}

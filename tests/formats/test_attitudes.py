"""Attitudes in files: orders of quaternions, angles, and NED with a forward-right-down body."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kedge.core.errors import DataError
from kedge.formats.attitudes import all_to_enu, from_ned, no_rotation, quaternions
from kedge.formats.logs import read_folder

ANGLES = np.array([[0.1, -0.2, 2.5], [0.0, 0.0, 0.0], [-3.0, 1.2, -0.7], [0.4, 0.3, 3.1]])
NED_TO_ENU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_TO_FLU = np.diag([1.0, -1, -1])


def of(turns: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.roll(turns, -1, axis=-1))


def test_angles_are_turned_about_z_then_y_then_x():
    roll, pitch, heading = ANGLES.T
    oracle = Rotation.from_euler("ZYX", np.stack([heading, pitch, roll], axis=1))
    assert (of(quaternions(roll, pitch, heading)) * oracle.inv()).magnitude().max() < 1e-14


def test_ned_with_forward_right_down_as_matrices():
    ned = quaternions(*ANGLES.T)
    oracle = NED_TO_ENU @ of(ned).as_matrix() @ FRD_TO_FLU
    np.testing.assert_allclose(of(from_ned(ned)).as_matrix(), oracle, atol=1e-14)


def test_a_vector_is_turned_with_its_body():
    # What the body sees ahead, 3 m right of it and 1 m below, is one place in both frames.
    ned, seen = quaternions(*ANGLES.T), np.array([5.0, 3.0, 1.0])
    columns = {f"place_{axis}": of(ned).apply(seen)[:, at] for at, axis in enumerate("xyz")}
    columns |= {f"attitude_{axis}": ned[:, at] for at, axis in enumerate("wxyz")}
    units = {name: "m" if name.startswith("place") else "1" for name in columns}
    enu, _ = all_to_enu(Path("log.csv"), columns, units)
    turns = np.stack([enu[f"attitude_{axis}"] for axis in "wxyz"], axis=1)
    places = np.stack([enu[f"place_{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(of(turns).apply(FRD_TO_FLU @ seen), places, atol=1e-13)


def test_lengths():
    turns = np.array(
        [[1.0, 0, 0, 0], [0, 0, 0, 0], [2, 0, 0, 0], [np.nan] * 4, [0.998, 0, 0, 0]]
    )
    assert no_rotation(turns).tolist() == [False, True, True, False, False]


LOG = """\
[sources.ahrs]
attitude = {{ columns = {columns}, order = "{order}"{unit} }}
frame = "{frame}"
"""


def read(folder: Path, order: str, frame: str, names: str, row: list[float], unit: str = ""):
    columns = [f"q{name}" for name in names]
    text = LOG.format(columns=columns, order=order, frame=frame, unit=unit)
    (folder / "log.toml").write_text(text)
    cells = ",".join(map(repr, row))
    (folder / "ahrs.csv").write_text(f"time,{','.join(columns)}\n0,{cells}\n")
    table = read_folder(folder).tables["ahrs"]
    return of(np.array([[table.columns[f"attitude_{axis}"][0] for axis in "wxyz"]]))


def test_the_order_is_said_in_the_log(tmp_path):
    turn = quaternions(*ANGLES[:1].T)[0]
    for order in ("wxyz", "xyzw"):
        row = np.roll(turn, -1 if order == "xyzw" else 0).tolist()
        found = read(tmp_path, order, "enu", order, row)
        assert (found * of(turn).inv()).magnitude().max() < 1e-12


def test_roll_pitch_and_compass_heading(tmp_path):
    # Heading east, nose 10 degrees up: forward is east and up.
    row = [0.0, 10.0, 90.0]
    found = read(tmp_path, "roll-pitch-heading", "ned", "rph", row, ', unit = "deg"')
    ahead = [np.cos(np.radians(10)), 0.0, np.sin(np.radians(10))]
    np.testing.assert_allclose(found.apply([1.0, 0, 0])[0], ahead, atol=1e-12)
    np.testing.assert_allclose(found.apply([0, 1.0, 0])[0], [0, 1, 0], atol=1e-12)


def test_a_mistaken_order(tmp_path):
    with pytest.raises(DataError, match="columns: found 3, expected 4 for xyzw"):
        read(tmp_path, "xyzw", "enu", "xyz", [0, 0, 0])
    with pytest.raises(DataError, match="order"):
        read(tmp_path, "zyxw", "enu", "zyxw", [0, 0, 0, 1])

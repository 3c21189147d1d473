"""Data of NaveGo: an IMU, GNSS fixes and the true trajectory in MATLAB files.

Axes are north, east, down and forward, right, down there; latitude and longitude become metres
from the first true place (:class:`kedge.numerics.earth.Origin`).

Source: R. Gonzalez, J. Giribet, H. Patiño, "NaveGo: a simulation framework for low-cost
integrated navigation systems", J. Control Eng. Appl. Inform. 17(2), 2015.
"""

from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from kedge.core.errors import DataError, UnknownName
from kedge.core.registry import readers, unknown
from kedge.formats.logs import RawLog
from kedge.formats.matlab import read_structure
from kedge.formats.tables import Table, stamps_of
from kedge.numerics.earth import Origin

AXES = "xyz"
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])


@readers.add("navego_synthetic")
def read_navego(path: Path, part: str | None = None) -> RawLog:
    """Read ``ref.mat``, ``gnss.mat`` and ``imu1.mat`` (or another, as ``part`` says).

    Raises:
        DataError: a file or a field is missing, or something in it is not finite.
        UnknownName: there is no such IMU.
    """
    if not path.is_dir():
        raise DataError(
            f"{path}: no such folder, expected ref.mat, gnss.mat and imu1.mat in it"
        )
    names = sorted(file.stem for file in path.glob("imu*.mat"))
    name = part or "imu1"
    if name not in names:
        raise UnknownName(f"{path}: {unknown('IMU', name, names)}")
    files = {key: path / f"{key}.mat" for key in ("ref", "gnss", name)}
    ref, gnss, imu = (read_structure(file, key) for key, file in files.items())
    truth = {key: _column(ref, files["ref"], key) for key in ("lat", "lon", "h")}
    latitude, longitude, height = (float(values[0]) for values in truth.values())
    origin = Origin(latitude, longitude, height)

    tables = {
        "imu": _table(
            "imu",
            files[name],
            _column(imu, files[name], "t"),
            {
                "specific_force": (_rows(imu, files[name], "fb") @ FLU_FROM_FRD, "m/s^2"),
                "angular_rate": (_rows(imu, files[name], "wb") @ FLU_FROM_FRD, "rad/s"),
            },
        ),
        "gnss": _table("gnss", files["gnss"], *_fixes(gnss, files["gnss"], origin)),
    }
    time, columns = _fixes(ref, files["ref"], origin)
    # They keep the matrix to the body column by column, which is its inverse row by row.
    ned_from_frd = _rows(ref, files["ref"], "DCMnb_m", 9).reshape(-1, 3, 3)
    map_from_body = ENU_FROM_NED @ ned_from_frd @ FLU_FROM_FRD
    columns["attitude"] = _quaternions(map_from_body), "1"
    reference = _table("ref", files["ref"], time, columns)
    return RawLog(
        f"NaveGo, {name}",
        tables,
        reference,
        files=tuple(files.values()),
        epoch="start of the simulation",
        place={"latitude": latitude, "height": height},
    )


def _rows(
    struct: Mapping[str, np.ndarray], file: Path, field: str, width: int = 3
) -> Float[np.ndarray, "n w"]:
    if field not in struct:
        raise DataError(f"{file}: {unknown('field', field, list(struct))}")
    values = struct[field]
    if values.ndim != 2 or values.shape[1] != width or len(values) < 2:
        raise DataError(
            f"{file}: {field} has the shape {values.shape}, expected rows of {width}"
        )
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise DataError(f"{file}: {field}: row {int(np.argmax(bad)) + 1} is not finite")
    return values


def _column(
    struct: Mapping[str, np.ndarray], file: Path, field: str
) -> Float[np.ndarray, " n"]:
    return _rows(struct, file, field, 1)[:, 0]


def _fixes(
    struct: Mapping[str, np.ndarray], file: Path, origin: Origin
) -> tuple[Float[np.ndarray, " n"], dict[str, tuple[np.ndarray, str]]]:
    """Times, positions on the map and velocities of fixes or of the truth."""
    place = [jnp.asarray(_column(struct, file, key)) for key in ("lat", "lon", "h")]
    position = np.asarray(jax.jit(jax.vmap(origin.to_map))(*place))
    velocity = _rows(struct, file, "vel") @ ENU_FROM_NED.T
    columns = {"position": (position, "m"), "velocity": (velocity, "m/s")}
    return _column(struct, file, "t"), columns


def _table(
    name: str,
    file: Path,
    time: Float[np.ndarray, " n"],
    fields: dict[str, tuple[Float[np.ndarray, "n w"], str]],
) -> Table:
    stamps = stamps_of(file, "t", time)
    if (steps := np.diff(stamps) <= 0).any():
        row = int(np.argmax(steps)) + 2
        raise DataError(f"{file}: t: row {row}: found a time that does not rise, expected one")
    columns, units = {}, {}
    for field, (values, unit) in fields.items():
        if len(values) != len(stamps):
            raise DataError(
                f"{file}: {field} has {len(values)} rows, expected {len(stamps)} as t has"
            )
        for index, axis in enumerate(AXES if values.shape[1] == 3 else "wxyz"):
            columns[f"{field}_{axis}"] = np.ascontiguousarray(values[:, index])
            units[f"{field}_{axis}"] = unit
    return Table(name, file, stamps, columns, {}, np.arange(1, len(stamps) + 1), units)


def _quaternions(matrices: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 4"]:
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(matrices).as_quat(), 1, axis=1)

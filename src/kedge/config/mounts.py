"""Mounts that a log tells, for sensors of which the rig says none."""

from typing import Any

from kedge.config.rigs import MountConfig, RigConfig
from kedge.estimation.mount import PLANE, SPACE
from kedge.formats.bag_frames import Placed
from kedge.formats.logs import RawLog

TILT = 0.02
"""rad; a sensor that is tilted by more does not measure in the plane."""


def with_mounts(
    config: RigConfig, raw: RawLog, fields: set[str], notes: list[str]
) -> RigConfig:
    """The rig with the mounts that the log knows, of a vehicle with these fields of the state.

    A sensor's own mount stays. ``notes`` says what was taken, and what could not be.
    """
    sensors: dict[str, Any] = dict(config.sensors)
    for name, spec in config.sensors.items():
        placed = raw.mounts.get(spec.source or name)
        if placed is None or spec.mount is not None or _is_none(placed):
            continue
        where = f"at {placed.x:.3g}, {placed.y:.3g}, {placed.z:.3g} m"
        if fields >= SPACE:
            mount = MountConfig(**{k: v for k, v in placed._asdict().items() if k != "frame"})
        elif fields >= PLANE and max(abs(placed.pitch), abs(placed.roll)) <= TILT:
            mount = MountConfig(x=placed.x, y=placed.y, heading=placed.heading)
        else:
            why = "it is tilted" if fields >= PLANE else "the state has no heading"
            notes.append(f"{name}: frame {placed.frame} {where}: no mount is taken, {why}")
            continue
        sensors[name] = spec.model_copy(update={"mount": mount})
        notes.append(
            f"{name}: mounted {where}, turned by {mount.heading:.3g} rad: frame {placed.frame} "
            "of /tf_static"
        )
    changed = config.model_copy(update={"sensors": sensors})
    changed._origin = config.origin
    return changed


def _is_none(placed: Placed) -> bool:
    return all(abs(value) < 1e-9 for value in placed[1:])

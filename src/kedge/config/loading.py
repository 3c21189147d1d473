"""Rigs and logs for programs: what the commands read, by the same code."""

import json
from collections.abc import Mapping
from os import PathLike
from typing import Any, cast

import numpy as np

from kedge.config.problem import load_problem, rig_of
from kedge.config.rigs import RigConfig, load_rig_config
from kedge.core.errors import ConfigError
from kedge.core.manifolds import space
from kedge.core.registry import sensors, vehicles
from kedge.estimation.log import Recording
from kedge.estimation.rig import Rig

Source = str | PathLike[str]
"""A file, or the name of one that comes with kedge."""
Settings = Mapping[str, Any]
"""Dotted key of a file -> value, in place of what the file says: ``{"output.rate": 5}``."""


def load_rig(rig: Source, settings: Settings | None = None) -> Rig:
    """A rig from a shipped name or a TOML file.

    Raises:
        UnknownName: no rig of that name is shipped.
        ConfigError: the file is missing or wrong, one line for each mistake; or it cannot be
            built without its log, since its prior or a map comes from there: see :func:`load`.
        ContractError: vehicle, sensors and prior do not fit together.
    """
    return rig_of(load_rig_config(str(rig), as_overrides(settings)))


def read_log(
    log: Source, rig: Source | Rig, truth: str = "auto", until: float | None = None
) -> Recording:
    """A log for a rig: its events, and its truth if it has one.

    A rig that was read from a file says where the columns are. For one that was put together in
    Python, ``log`` is a folder with ``control.csv`` and a table for each sensor, ``NAME.csv``,
    whose columns are called as the components of control and measurement are, in SI units.

    Args:
        log: PATH or PATH#PART.
        rig: a rig, a shipped rig's name or a TOML file.
        truth: "auto" for the log's own, "none", or a source of the log.
        until: stop this many seconds after the start.

    Raises:
        KedgeError: a file cannot be used, or rig and log do not fit; one line for each mistake.
    """
    if not isinstance(rig, Rig):
        return load(rig, log, truth, until)[1]
    known = rig.origin.config
    config = known if isinstance(known, RigConfig) else _plain_config(rig)
    return _loaded(config, log, truth, until)[1]


def load(
    rig: Source,
    log: Source,
    truth: str = "auto",
    until: float | None = None,
    settings: Settings | None = None,
) -> tuple[Rig, Recording]:
    """A rig and a log that belong together; the prior or a map may come from the log.

    Raises:
        KedgeError: a file cannot be used, or rig and log do not fit; one line for each mistake.
    """
    config = load_rig_config(str(rig), as_overrides(settings))
    return _loaded(config, log, truth, until)


def as_overrides(settings: Settings | None) -> dict[str, str]:
    """Values as TOML: for numbers, words, lists and tables of them."""
    return {key: _toml(value) for key, value in (settings or {}).items()}


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        table = cast("Mapping[str, Any]", value)
        inside = ", ".join(f"{json.dumps(key)} = {_toml(part)}" for key, part in table.items())
        return f"{{{inside}}}"
    if isinstance(value, str | bool):
        return json.dumps(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float | np.floating | np.integer):
        return repr(value.item() if isinstance(value, np.generic) else value)
    return f"[{', '.join(map(_toml, value))}]"


def _loaded(
    config: RigConfig, log: Source, truth: str, until: float | None
) -> tuple[Rig, Recording]:
    problem = load_problem(config, str(log), truth, until)
    facts = {"truth": problem.truth, "notes": tuple(problem.notes)}
    return problem.rig, problem.recording._replace(**facts)


def _plain_config(rig: Rig) -> RigConfig:
    """What a rig file would say of a rig whose log names its columns as the rig does.

    Raises:
        ConfigError: its vehicle or a sensor is not registered, or has a map of targets, whose
            names nobody knows.
    """
    members = {"vehicle": (rig.vehicle, vehicles)}
    members |= {f"sensors.{own.name}": (own.sensor, sensors) for own in rig.sensors}
    models = {}
    for key, (model, family) in members.items():
        models[key] = family.name_of(type(model))
        if models[key] not in family.names():
            raise ConfigError(
                f"{key}: {type(model).__name__} is not registered, so no rig file can name "
                "it; assemble the log with kedge.estimation.log.assemble"
            )
    for own in rig.sensors:
        if own.targets is not None:
            raise ConfigError(
                f"sensors.{own.name}: reads targets of a map: read the log with a rig "
                "file that names them"
            )
    driven = bool(space(rig.vehicle.nominal_control(0.0)).column_units)
    return RigConfig.model_validate({
        "vehicle": {"model": models["vehicle"]},
        "sensors": {
            own.name: {"model": models[f"sensors.{own.name}"], "latency": own.latency}
            for own in rig.sensors
        },
        "prior": {"covariance": np.asarray(rig.prior.cov).tolist()},
    } | ({"control": {"source": "control"}} if driven else {}))  # fmt: skip

"""From the tables of a rig or scenario file to its models: vehicle, sensors, prior."""

import math
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from kedge.config.models import Parameter, build_model
from kedge.config.plugin_checks import check_sensor_plugins, check_vehicle_plugin
from kedge.config.plugins import place_of
from kedge.config.readings import join, map_of
from kedge.config.rigs import AbstractRigConfig, RigConfig
from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractSensor, AbstractVehicle
from kedge.core.errors import ConfigError, ContractError
from kedge.core.manifolds import charts_of, component_names, space_of
from kedge.core.registry import sensors, unknown, vehicles
from kedge.estimation.error_states import with_errors
from kedge.estimation.rig import Installation, Mount, Origin, Rig, check_reads
from kedge.formats.attitudes import quaternions
from kedge.formats.logs import TargetMap
from kedge.numerics.losses import Loss
from kedge.vehicles.augmented import Drift, augment


def build_vehicle(
    config: AbstractRigConfig, maps: Mapping[str, TargetMap] | None = None
) -> tuple[AbstractVehicle, AbstractVehicle]:
    """The vehicle without and with its augmented states, once every sensor is known to fit it.

    Without ``maps``, before a log is read, sensors have the maps of their defaults: enough to
    see what does not fit, but an augmented state may have a component for each target of a map.

    Raises:
        ContractError: the vehicle refuses its parameters, or a sensor reads what it has not.
    """
    built = {} if maps is None else {n: build_sensor(config, n, maps) for n in config.sensors}
    try:
        bare = build_model(vehicles.get(config.vehicle.model), config.vehicle.parameters)
        plain = built or {
            name: build_model(sensors.get(spec.model), spec.parameters)
            for name, spec in config.sensors.items()
        }
        augmented = {
            name: Drift(augmented.random_walk, augmented.time_constant or float("inf"))
            for name, augmented in config.vehicle.augmented.items()
        }
        check_vehicle_plugin(bare)
        vehicle = augment(bare, augmented, list(plain.values()))
        for name, sensor in plain.items():
            installation = build_installation(config, name, sensor)
            try:
                check_reads(installation, type(vehicle.start()), type(bare).__name__)
            except ContractError as error:
                place = place_of(type(sensor))
                raise ContractError(f"{place}: {error}" if place else str(error)) from error
        check_sensor_plugins(plain, vehicle.start())
    except ContractError as error:
        raise ContractError(f"{config.origin}: {error}") from error
    return bare, vehicle


def build_installation(
    config: AbstractRigConfig,
    name: str,
    sensor: AbstractSensor,
    true_sensor: AbstractSensor | None = None,
) -> Installation:
    """A sensor as it is installed: rate, latency, gate, mount, noise."""
    spec = config.sensors[name]
    mount = None if spec.mount is None else Mount(**spec.mount.model_dump())
    robust = spec.robust and Loss(spec.robust.loss, spec.robust.tuning, spec.robust.side)
    gates = (
        spec.gate,
        mount,
        robust,
        spec.recovery,
        spec.allowed_silence,
        spec.all_targets,
        true_sensor,
        spec.error and spec.error.build(hasattr(sensor, "target")),
    )
    return Installation(name, sensor, spec.rate, spec.latency, *gates)


def build_sensor(
    config: AbstractRigConfig,
    name: str,
    maps: Mapping[str, TargetMap],
    changes: Mapping[str, Parameter] = {},
) -> AbstractSensor:
    """A sensor with its parameters, perhaps some of them changed, and its map.

    Raises:
        ConfigError: the map is unknown, or lacks a column.
        ContractError: the sensor refuses its parameters.
    """
    spec = config.sensors[name]
    cls, parameters = sensors.get(spec.model), {**spec.parameters, **changes}
    try:
        sensor = build_model(cls, parameters)
        if spec.map is None:
            return sensor
        targets, default = map_of(config, name, maps), sensor.target
        fields = {}
        for field, value in default._asdict().items():
            labels = component_names(field, math.prod(np.shape(value)[1:]))
            if field in default._field_defaults and not set(labels) & set(targets.columns):
                continue
            for label in labels:
                if label not in targets.columns:
                    what = unknown("column", label, list(targets.columns))
                    raise ConfigError(
                        f"{config.origin}: sensors.{name}: map {spec.map!r}: {what}"
                    )
            shape = (len(targets.ids), *np.shape(value)[1:])
            fields[field] = join(targets.columns, labels, shape)
        return build_model(cls, parameters, target=type(default)(**fields))
    except ContractError as error:
        raise ContractError(f"{config.origin}: sensors.{name}: {error}") from error


def build_prior(
    config: AbstractRigConfig,
    bare: AbstractVehicle,
    vehicle: AbstractVehicle,
    known: Mapping[str, Any],
) -> Gaussian:
    """What is believed at the start; ``known`` are fields of the true state then."""
    prior, mean = config.prior, vehicle.start()
    charts, given = charts_of(type(mean)), {}
    for field, values in prior.mean.items():
        turned = charts[field].shape != charts[field].tangent_shape
        if turned and len(values) == 3:  # roll, pitch, heading
            given[field] = jnp.asarray(quaternions(*map(np.asarray, values)))
            continue
        full = np.broadcast_to(values, charts[field].shape or (1,))
        given[field] = jnp.asarray(full.reshape(charts[field].shape))
    given |= {field: jnp.asarray(value) for field, value in known.items()}
    bare_space = space_of(type(bare.start()))
    stds = dict(prior.std) | {
        name: [augmented.std] for name, augmented in config.vehicle.augmented.items()
    }
    cov = np.zeros((space_of(type(mean)).size,) * 2)
    for field, cut in space_of(type(mean)).slices().items():
        if field in stds:
            cov[cut, cut] = np.diag(np.broadcast_to(stds[field], cut.stop - cut.start) ** 2)
    if prior.covariance is not None:
        cov[: bare_space.size, : bare_space.size] = prior.covariance
    return Gaussian(mean._replace(**given), jnp.asarray(cov))


def build_rig(
    config: AbstractRigConfig,
    vehicle: AbstractVehicle,
    sensors: tuple[Installation, ...],
    prior: Gaussian,
) -> Rig:
    """The rig of a file, with its sensors' errors in its state.

    The file is named where vehicle, sensors and prior do not fit.

    Raises:
        ContractError: they do not.
    """
    try:
        origin = Origin(config) if isinstance(config, RigConfig) else Origin()
        return with_errors(Rig(vehicle, sensors, prior, origin))
    except ContractError as error:
        raise ContractError(f"{config.origin}: {error}") from error

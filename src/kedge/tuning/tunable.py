"""The numbers of a rig that can be tuned: where each stands, and whether it is noise."""

import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kedge.core.contracts import AbstractVehicle
from kedge.core.errors import ConfigError
from kedge.core.manifolds import space
from kedge.core.registry import unknown
from kedge.estimation.error_states import with_error
from kedge.estimation.rig import Rig, as_arrays
from kedge.vehicles.augmented import Augmented

Path = tuple[str | int, ...]


class Tunable(NamedTuple):
    """A number of a rig."""

    key: str
    """As in a rig file: ``sensors.gnss.parameters.std``."""
    path: Path
    """Where it stands in the :class:`~kedge.estimation.rig.Rig`."""
    value: float
    unit: str
    is_noise: bool
    """Whether it says how noisy something is, and not what happens without noise."""

    @property
    def latency_of(self) -> int | None:
        """The sensor whose latency it is; None if it is something else."""
        return int(self.path[1]) if self.path[-1] == "latency" else None

    @property
    def error_of(self) -> int | None:
        """The sensor of whose error with a memory it is; None if it is something else."""
        return int(self.path[1]) if "error" in self.path else None

    @property
    def is_logarithmic(self) -> bool:
        """Whether it is tuned by its logarithm: above 0, and meant to be."""
        return self.value > 0 and self.latency_of is None and "mount" not in self.path


def tunables(rig: Rig) -> list[Tunable]:
    """Every number of the vehicle, its augmented states, the sensors, their errors and mounts.

    What is noise is found by asking the models: a number that changes how a step or a reading
    scatters, but not what it is without noise.
    """
    numbers = [*_of_vehicle(rig), *_of_sensors(rig)]
    numeric = [t for t in numbers if t.latency_of is None and t.error_of is None]
    noisy = dict(zip([t.key for t in numeric], _are_noise(rig, numeric), strict=True))
    # An error with a memory is noise by what it is, also where it is no state.
    return [
        t._replace(is_noise=noisy.get(t.key, t.error_of is not None and t.path[-1] == "std"))
        for t in numbers
    ]


def choose(rig: Rig, names: Sequence[str] | None) -> list[Tunable]:
    """The tunables named by key, or by a unique end of it (``std``, ``gnss.parameters.std``).

    Without names all noise above 0 that the rig's behaviour depends on, but no period.

    Raises:
        ConfigError: a name is unknown, stands for several, or stands twice.
    """
    available = tunables(rig)
    if names is None:
        chosen = [t for t in available if t.is_noise and t.value > 0 and t.unit != "s"]
        if not chosen:
            raise ConfigError(
                "parameters: the rig has no noise to tune; name some of "
                f"{', '.join(t.key for t in available) or 'none'}"
            )
        return chosen
    chosen = [_named(available, name) for name in names]
    for tunable in chosen:
        if chosen.count(tunable) > 1:
            raise ConfigError(f"parameters: found {tunable.key} twice, expected it once")
    if not chosen:
        raise ConfigError("parameters: found none, expected at least one")
    return chosen


def placed(rig: Rig, chosen: Sequence[Tunable], values: Float[Array, " p"]) -> Rig:
    """The rig with other values; latencies belong to logs and stay as they are."""
    where = [
        (t.path, values[i])
        for i, t in enumerate(chosen)
        if t.latency_of is None and t.error_of is None
    ]
    if where:
        rig = eqx.tree_at(
            lambda tree: [_follow(tree, path) for path, _ in where], rig, [v for _, v in where]
        )
    errors: dict[int, dict[str, Any]] = {}
    for index, tunable in enumerate(chosen):
        if tunable.error_of is not None:
            errors.setdefault(tunable.error_of, {})[str(tunable.path[-1])] = values[index]
    for place, changed in errors.items():
        error: Any = rig.sensors[place].error
        now = {"std": error.std, "time_constant": error.time_constant} | changed
        rig = with_error(rig, rig.sensors[place].name, **now)
    return rig


def _named(available: Sequence[Tunable], name: str) -> Tunable:
    exact = [t for t in available if t.key == name]
    ends = exact or [t for t in available if t.key.endswith(f".{name}")]
    if not ends:
        raise ConfigError(
            f"parameters: {unknown('parameter', name, [t.key for t in available])}"
        )
    if len(ends) > 1:
        raise ConfigError(
            f"parameters: {name!r} stands for {', '.join(t.key for t in ends)}; "
            "expected a name for one of them"
        )
    return ends[0]


def _of_vehicle(rig: Rig) -> list[Tunable]:
    vehicle, at = rig.vehicle, ("vehicle",)
    augmented: Mapping[str, Any] = {}
    if isinstance(vehicle, Augmented):
        vehicle, at, augmented = vehicle.vehicle, ("vehicle", "vehicle"), vehicle.augmented
    numbers = [
        Tunable(f"vehicle.parameters.{name}", (*at, name), value, unit, False)
        for name, value, unit in _numbers(vehicle)
        # What is estimated with the state is not tuned.
        if name not in augmented
    ]
    for name, quantity in augmented.items():
        for field, unit in (("random_walk", ""), ("time_constant", "s")):
            value = getattr(quantity, field)
            # Errors of sensors have one for each of theirs, and are tuned by the sensor.
            if np.ndim(value) == 0 and np.isfinite(value):
                key = f"vehicle.augmented.{name}.{field}"
                numbers.append(
                    Tunable(
                        key, ("vehicle", "augmented", name, field), float(value), unit, False
                    )
                )
    return numbers


def _of_sensors(rig: Rig) -> list[Tunable]:
    numbers = []
    for index, installation in enumerate(rig.sensors):
        at, key = ("sensors", index), f"sensors.{_quoted(installation.name)}"
        numbers += [
            Tunable(f"{key}.parameters.{name}", (*at, "sensor", name), value, unit, False)
            for name, value, unit in _numbers(installation.sensor)
        ]
        for field, unit in (("std", ""), ("time_constant", "s")):
            value = getattr(installation.error, field, None)
            if value is not None and np.ndim(value) == 0 and np.isfinite(value):
                path = (*at, "error", field)
                numbers.append(Tunable(f"{key}.error.{field}", path, float(value), unit, False))
        if installation.mount is not None:
            places = [("x", "m"), ("y", "m"), ("heading", "rad")]
            if hasattr(rig.prior.mean, "attitude"):
                places += [("z", "m"), ("roll", "rad"), ("pitch", "rad")]
            for name, unit in places:
                value = float(getattr(installation.mount, name))
                numbers.append(
                    Tunable(f"{key}.mount.{name}", (*at, "mount", name), value, unit, False)
                )
        numbers.append(
            Tunable(f"{key}.latency", (*at, "latency"), installation.latency, "s", False)
        )
    return numbers


def _quoted(name: str) -> str:
    """A part of a dotted key, as TOML wants it."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)


def _numbers(model: Any) -> list[tuple[str, float, str]]:
    """Name, value and unit of a model's parameters that are numbers on a continuous scale."""
    hints = get_type_hints(type(model), include_extras=True)
    numbers = []
    for field in dataclasses.fields(model):
        value = getattr(model, field.name)
        kind = jnp.result_type(value) if isinstance(value, float | jax.Array) else None
        if field.metadata.get("static") or kind is None or jnp.ndim(value):
            continue
        if jnp.issubdtype(kind, jnp.floating):
            marks = getattr(hints[field.name], "__metadata__", ())
            unit = next((m.unit for m in marks if hasattr(m, "unit")), "1")
            numbers.append((field.name, float(value), unit))
    return numbers


def _are_noise(rig: Rig, chosen: Sequence[Tunable]) -> list[bool]:
    """Whether each changes the scatter of a step or of a reading, and nothing else."""
    if not chosen:
        return []
    rig = as_arrays(rig)

    def behaviour(values: Float[Array, " p"]) -> tuple[Array, Array]:
        changed = placed(rig, chosen, values)
        calm, rough = _moved(changed.vehicle, 0.0), _moved(changed.vehicle, 1.0)
        state = space(changed.prior.mean).boxplus(
            changed.prior.mean, _nudge(changed.prior.mean)
        )
        target = jnp.zeros((), int)
        seen = [space(z).flatten(z) for z in (s.expect(state, target) for s in changed.sensors)]
        scatter = [jnp.ravel(s.noise_cov(state, target)) for s in changed.sensors]
        return jnp.concatenate([calm, *seen]), jnp.concatenate([rough - calm, *scatter])

    values = jnp.asarray([t.value for t in chosen])
    calm, rough = jax.jit(jax.jacfwd(behaviour))(values)
    same, other = np.all(np.asarray(calm) == 0, axis=0), np.any(np.asarray(rough) != 0, axis=0)
    return (same & other).tolist()


def _moved(vehicle: AbstractVehicle, share: float) -> Float[Array, " n"]:
    """Where a second with some noise leads from a state that is none in particular."""
    state, density = vehicle.start(), vehicle.noise_density()
    control = jax.tree.map(lambda leaf: leaf + 0.1, as_arrays(vehicle.nominal_control(1.0)))
    state = space(state).boxplus(state, _nudge(state))
    noise = jax.tree.map(lambda leaf: share * leaf, density)
    return space(state).boxminus(vehicle.step(state, control, noise, 1.0), state)


def _nudge(state: Any) -> Float[Array, " n"]:
    return 0.1 + 0.01 * jnp.arange(space(state).size)


def _follow(tree: Any, path: Path) -> Any:
    for part in path:
        nested = isinstance(part, int) or isinstance(tree, dict)
        tree = tree[part] if nested else getattr(tree, str(part))
    return tree

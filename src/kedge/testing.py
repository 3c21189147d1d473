"""The contracts as checks, for kedge's own members and for anybody's.

A test that calls ``check_vehicle("my-vehicle")`` (or passes the class, or an instance) is all
that a new vehicle, sensor or filter needs. Each check raises a ``ContractError`` that names the
law, what was found and what was expected. Every check compiles its member once and then tries
it at many random points; the seeds are fixed, so that what passes keeps passing.
"""

import functools as ft
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core import registry
from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractFilter, AbstractSensor, AbstractVehicle
from kedge.core.errors import ContractError
from kedge.core.manifolds import Circle, Rotation, Space, space_of
from kedge.core.quantities import Scalar
from kedge.core.verdicts import Verdict
from kedge.estimation.batch import Estimates, estimate
from kedge.estimation.log import Log, Readings, Schedule
from kedge.estimation.online import Estimator
from kedge.estimation.reading import sight
from kedge.estimation.rig import Installation, Rig
from kedge.numerics.linalg import cholesky
from kedge.numerics.noise import process_std
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import record

__all__ = ["check_filter", "check_sensor", "check_vehicle", "quick_jit"]

POINTS = 16
SUBSTEPS = 16
DIFFERENCE = 1e-5
SPAN = 60.0  # s

quick_jit = ft.partial(
    jax.jit,
    compiler_options={
        "xla_backend_optimization_level": 0,
        "xla_llvm_disable_expensive_passes": True,
        "xla_cpu_parallel_codegen_split_count": 1,
    },
)
"""``jax.jit`` for what runs a few times only: compiles in half the time, runs slower."""


def check_vehicle(vehicle: str | type | AbstractVehicle, dt: float = 0.1) -> None:
    """Check a vehicle against its contract, with steps of ``dt`` s.

    Raises:
        ContractError: the first law that it breaks.
    """
    model, require = _member(vehicle, registry.vehicles, AbstractVehicle)
    state, density, control = model.start(), model.noise_density(), model.drive(0.0)
    states = _charted(require, "start()", state)
    noises = _charted(require, "noise_density()", density, tangent=True)
    controls = _charted(require, "drive(0)", control)
    _charted(require, "drive(1)", model.drive(1.0), of=type(control))

    deviation = np.asarray(noises.flatten(density))
    require(
        "noise densities are finite and not negative",
        bool(np.isfinite(deviation).all() and (deviation >= 0).all()),
        found=deviation,
    )
    calm = noises.unflatten(noises.zeros())
    with _tracing(require, "step can be traced"):
        after = jax.eval_shape(
            lambda s, u, w, h: model.step(s, u, w, h), state, control, calm, dt
        )
    require(
        "step keeps the structure, the shapes and the dtypes of the state",
        _layout(after) == _layout(state),
        found=_layout(after),
        expected=_layout(state),
    )

    def figures(key: PRNGKeyArray) -> dict[str, Array]:
        some, other = jr.split(key)
        points = jax.vmap(states.boxplus, (None, 0))(state, _tangents(states, some))
        errors = _tangents(states, other, seam=True)
        still = _origin(controls)
        law = ft.partial(_vehicle_figures, model, still, dt)
        return jax.vmap(law)(points, errors, jnp.linspace(0.0, SPAN, POINTS)) | {
            "drive": _driven(model)
        }

    with _tracing(require, "step can be differentiated and mapped over states"):
        found = {
            name: np.asarray(value) for name, value in quick_jit(figures)(jr.key(1)).items()
        }

    size = 1e-9 * (1 + found["size"].max())
    require.small(
        "boxminus undoes boxplus, also near half a turn", found["minus of plus"], size
    )
    require.small(
        "boxplus undoes boxminus, also near half a turn", found["plus of minus"], size
    )
    require.small("a step of 0 s changes nothing", found["no time"], 1e-12 * (1 + size))
    require.small(
        "two half steps are one step to third order: halving the step leaves 1/6 of the gap",
        found["gap of half the step"],
        found["gap"] / 6 + 1e-12 * (1 + found["size"]),
    )
    require.small(
        "noise has one variance however time is cut into steps: it acts for dt, is drawn with "
        f"std density / sqrt(dt); within a quarter in {SUBSTEPS // 2} and {SUBSTEPS} steps",
        found["noise"],
        1e-300,
    )
    require.finite("the Jacobians are finite, also at rest", found["jacobian"])
    require.small("the Jacobians are those of central differences", found["slope"], 1e-6)
    require.finite(f"what drive() does stays finite for {SPAN:g} s", found["drive"])


def check_sensor(sensor: str | type | AbstractSensor) -> None:
    """Check a sensor against its contract; one with a map, against each of its targets.

    Raises:
        ContractError: the first law that it breaks.
    """
    model, require = _member(sensor, registry.sensors, AbstractSensor)
    reads, outputs = (
        _charted_class(require, name, getattr(model, name, None))
        for name in ("reads", "measures")
    )
    for name, default in model.reads._field_defaults.items():
        shape = dict(zip(reads.cls._fields, reads.charts, strict=True))[name].shape
        require(
            f"the default of the optional field {name!r} has the shape of its quantity",
            np.shape(default) == shape,
            found=np.shape(default),
            expected=shape,
        )
    rate = model.nominal_rate
    require("nominal_rate is positive and finite", 0 < rate < np.inf, found=rate)

    origin = _origin(reads)
    targets = Installation("checked", model).targets
    require("its map has a target", targets != 0, found="an empty map")
    with _tracing(require, "observe can be traced"):
        seen = jax.eval_shape(lambda point: model.facing(0).observe(point), origin)
        noise = jax.eval_shape(lambda point: model.facing(0).noise_std(point), origin)
    expected = [(chart.shape, _float()) for chart in outputs.charts]
    _require_layout(
        require, "observe returns what measures says", seen, model.measures, expected
    )
    spreads = [(chart.tangent_shape, None) for chart in outputs.charts]
    _require_layout(
        require, "noise_std returns what measures says", noise, model.measures, spreads
    )

    def figures(key: PRNGKeyArray) -> dict[str, Array]:
        some, other = jr.split(key)
        points = jax.vmap(reads.boxplus, (None, 0))(origin, 3 * _tangents(reads, some))
        errors = _tangents(outputs, other, seam=True)
        at = jnp.arange(POINTS) % (targets or 1)
        return jax.vmap(ft.partial(_sensor_figures, model, reads, outputs))(points, errors, at)

    with _tracing(require, "observe can be differentiated and mapped over states"):
        found = {
            name: np.asarray(value) for name, value in quick_jit(figures)(jr.key(2)).items()
        }

    require(
        "the noise is positive",
        bool((found["std"] > 0).all() and np.isfinite(found["std"]).all()),
        found=found["std"].min(),
        expected="> 0 and finite",
    )
    require("dof is the size of the measurement", int(model.dof()) == outputs.size, model.dof())
    require.finite("the measurement is finite", found["measurement"])
    require.small(
        "residuals wrap: z (+) d (-) z is d, also near half a turn", found["wrap"], 1e-9
    )
    require.small(
        "a turn of the state by 360 degrees changes no measurement", found["turn"], 1e-9
    )
    require.small("noise_cov is symmetric", found["skew"], 1e-12 * (1 + found["cov"].max()))
    require.finite("noise_cov is positive definite", found["root"])
    require.finite("the Jacobian is finite", found["jacobian"])
    require.small("the Jacobian is that of central differences", found["slope"], 1e-6)


def check_filter(filter: str | type | AbstractFilter) -> None:
    """Check a filter against its contract, on a matched log.

    It runs on a unicycle that sees landmarks; one that refuses nonlinear models with a
    ``ContractError`` runs on a vehicle of constant velocity with GNSS.

    Raises:
        ContractError: the first law that it breaks.
    """
    model, require = _member(filter, registry.filters, AbstractFilter)
    rig = _rig_for(model, require)
    key = jr.key(4)
    recording, _ = record(Scenario(rig, duration=3.0), jr.key(3), output_rate=5.0)
    log = jax.tree.map(np.asarray, recording.log)
    runs = (log.readings, _spoilt(log.readings), _missing(log.readings))
    silent = log.schedule._replace(sensor=np.full_like(log.schedule.sensor, -1))

    @quick_jit
    def run(schedule: Schedule, readings: Any) -> Estimates:
        return estimate(model, rig, Log(schedule, log.controls, readings), key)

    def runs_at_once(rate: Float[Array, ""], key: PRNGKeyArray) -> Any:
        installation = rig.sensors[0]
        one, measurement = sight(installation, _row(log.readings[0], 0))
        belief = model.init(rig.prior, key)
        belief = model.predict(rig.vehicle, belief, _row(log.controls, 0), rate, key)
        return model.update(one, belief, measurement, key)

    with _tracing(require, "it can be mapped over runs, with jax.vmap"):
        jax.eval_shape(jax.vmap(runs_at_once), np.full(2, 0.1), jr.split(key, 2))
    with _tracing(require, "it can be traced and scanned over a log"):
        found = jax.tree.map(
            lambda *leaves: np.stack(leaves), *(run(log.schedule, one) for one in runs)
        )
    for index, label in enumerate(("as they are", "spoilt", "missing")):
        moments = _row(found.moments, index)
        require.finite(
            f"the moments are finite, with readings {label}",
            np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(moments)]),
        )
        scale = np.abs(moments.cov).max()
        skew = np.abs(moments.cov - np.swapaxes(moments.cov, 1, 2))
        require.small("covariances are symmetric", skew, 1e-9 * scale)
        lowest = -np.linalg.eigvalsh(moments.cov).min()
        require.small("covariances have no negative eigenvalue", lowest, 1e-9 * scale)

    require(
        "the same key gives the same bytes",
        _bytes(run(log.schedule, runs[0])) == _bytes(_row(found, 0)),
        found="two results",
        expected="one",
    )
    verdicts = found.outcome.verdict[2][log.schedule.sensor >= 0]
    require(
        "a reading that is missing is not used",
        bool((verdicts == Verdict.NOT_FINITE).all()),
        found=[Verdict(verdict).name for verdict in verdicts],
        expected="NOT_FINITE",
    )
    alone, gone = run(silent, runs[2]).moments, _row(found.moments, 2)
    require.small("a missing reading leaves the prediction", _distance(alone, gone), 1e-12)

    for index in range(2):
        moments, verdicts = _row((found.moments, found.outcome.verdict), index)
        same = log._replace(readings=runs[index])
        gap, verdict = _online_gap(model, rig, same, key, moments, verdicts)
        require("batch and online give the same verdicts", verdict is None, found=verdict)
        require.small("batch and online agree", gap, 1e-9)


class _Require:
    """Raises unless a law holds; knows whose contract it is."""

    def __init__(self, member: str):
        self.member = member

    def __call__(self, law: str, holds: bool, found: Any, expected: Any = None) -> None:
        if not holds:
            wanted = "" if expected is None else f"; expected {expected}"
            raise ContractError(f"{self.member} breaks the law '{law}': found {found}{wanted}")

    def small(self, law: str, values: Any, bound: Any) -> None:
        """No value is beyond its bound, and none is NaN."""
        values, bound = np.broadcast_arrays(np.asarray(values), np.asarray(bound))
        excess = np.where(np.isfinite(values), values - bound, np.inf)
        worst = np.unravel_index(np.argmax(excess), excess.shape)
        holds = bool((excess <= 0).all())
        self(law, holds, f"{values[worst]:.3g}", f"at most {bound[worst]:.3g}")

    def finite(self, law: str, values: Any) -> None:
        """All values are finite."""
        bad = np.count_nonzero(~np.isfinite(values))
        self(law, bool(bad == 0), f"{bad} of {np.size(values)} values that are not", "none")


class _Tracing(NamedTuple):
    """Turns what a member raises into a ``ContractError`` that says when."""

    require: _Require
    law: str

    def __enter__(self) -> None: ...

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, Exception):
            first = str(error).strip().splitlines() or [""]
            found = f"{type(error).__name__}: {first[0]}"
            raise ContractError(
                f"{self.require.member} breaks the law '{self.law}': found {found}"
            ) from error


_tracing = _Tracing


def _member(given: Any, family: registry.Registry, base: type) -> tuple[Any, _Require]:
    """An instance of the member with its defaults, and the one who complains about it."""
    if isinstance(given, base):
        cls, label = type(given), type(given).__name__
    else:
        cls = family.get(given) if isinstance(given, str) else given
        label = f"{given!r} ({cls.__name__})" if isinstance(given, str) else cls.__name__
    require = _Require(f"{family.family[:-1]} {label}")
    require(f"it is an {base.__name__}", issubclass(cls, base), cls.__mro__[1].__name__)
    require(
        "its docstring has a Source",
        "Source:" in (cls.__dict__.get("__doc__") or ""),
        found="none",
        expected="'Source: author, title, year, section'",
    )
    if isinstance(given, base):
        return given, require
    try:
        return cls(), require
    except TypeError as error:
        raise ContractError(
            f"{require.member} breaks the law 'it can be made without arguments': {error}; "
            "give every field a default and define every abstract method"
        ) from error


def _charted_class(require: _Require, name: str, cls: Any) -> Space:
    require(
        f"{name} is a NamedTuple class of quantities",
        isinstance(cls, type) and issubclass(cls, tuple) and hasattr(cls, "_fields"),
        found=cls,
    )
    return space_of(cls)


def _charted(
    require: _Require, name: str, value: Any, tangent: bool = False, of: Any = None
) -> Space:
    """The space of a value, whose shapes must be those of its charts."""
    found = _charted_class(require, f"type of {name}", type(value))
    require(f"{name} is always of one type", of in (None, type(value)), type(value), of)
    expected = [chart.tangent_shape if tangent else chart.shape for chart in found.charts]
    shapes = [np.shape(leaf) for leaf in value]
    require(f"{name} has the shapes of its quantities", shapes == expected, shapes, expected)
    return found


def _layout(tree: Any) -> Any:
    leaves, structure = jax.tree.flatten(tree)
    return str(structure), [(np.shape(leaf), str(jnp.result_type(leaf))) for leaf in leaves]


def _require_layout(
    require: _Require, law: str, value: Any, cls: Any, expected: list[tuple[Any, Any]]
) -> None:
    require(law, type(value) is cls, type(value), cls)
    found = [
        (np.shape(leaf), None if dtype is None else str(jnp.result_type(leaf)))
        for leaf, (_, dtype) in zip(value, expected, strict=True)
    ]
    require(law, found == expected, found, expected)


def _float() -> str:
    """Name of the floats that are computed with."""
    return str(jnp.result_type(float))


def _origin(found: Space) -> Any:
    """A point of any space: where each chart puts what is missing."""
    missing = found.cls(*(jnp.full(chart.shape, jnp.nan) for chart in found.charts))
    return found.complete(missing)[0]


def _tangents(found: Space, key: PRNGKeyArray, seam: bool = False) -> Float[Array, "k n"]:
    """Random tangent vectors; with ``seam``, every other one turns by nearly half a turn."""
    white = jr.normal(key, (POINTS, found.size))
    if not seam:
        return white
    short = jnp.asarray([1e-2, 1e-4, 1e-7, 1e-9])[jnp.arange(POINTS) // 2 % 4]
    near = jnp.where(jnp.arange(POINTS) % 4 < 2, 1, -1) * (jnp.pi - short)
    at_seam = (jnp.arange(POINTS) % 2 == 1)[:, None]
    parts = []
    for chart, part in zip(found.charts, found.slices().values(), strict=True):
        piece = white[:, part]
        if isinstance(chart, Circle):
            # Without the seam too, an angle's differences are shorter than half a turn.
            piece = jnp.where(at_seam, near[:, None], jnp.pi * jnp.tanh(piece) * 0.9)
        elif isinstance(chart, Rotation):
            axis = piece / jnp.linalg.norm(piece, axis=1, keepdims=True)
            length = jnp.pi * 0.9 * jnp.tanh(jnp.linalg.norm(piece, axis=1, keepdims=True))
            piece = axis * jnp.where(at_seam, near[:, None], length)
        parts.append(piece)
    return jnp.concatenate([jnp.zeros((POINTS, 0)), *parts], axis=1)


def _vehicle_figures(
    model: Any, still: Any, dt: float, state: Any, error: Float[Array, " n"], time: Scalar
) -> dict[str, Array]:
    states, noises = space_of(type(state)), space_of(type(model.noise_density()))
    control, calm = model.drive(time), noises.zeros()

    def walk(length: Array) -> Any:
        """The states after one and after two steps."""

        def body(start: Any, _: None) -> tuple[Any, Any]:
            after = model.step(start, control, noises.unflatten(calm), length)
            return after, after

        return jax.lax.scan(body, state, length=2)[1]

    def slopes(start: Any, length: Array, drive: Any) -> tuple[tuple[Array, Array], Any]:
        """Jacobians of a step by the error before it and by the noise; the state after it."""

        def end(error: Array, noise: Array) -> tuple[Array, Any]:
            begun = states.boxplus(start, error)
            after = model.step(begun, drive, noises.unflatten(noise), length)
            return states.boxminus(after, jax.lax.stop_gradient(after)), after

        return jax.jacfwd(end, (0, 1), has_aux=True)(states.zeros(), calm)

    def spread(length: Array, drive: Any) -> tuple[Array, Array]:
        """The covariance that noise leaves after each of some steps, and all Jacobians."""

        def body(carry: tuple[Any, Array], _: None) -> tuple[Any, Any]:
            start, cov = carry
            (slope, effect), after = slopes(start, length, drive)
            scaled = effect * process_std(model, length)[None]
            cov = slope @ cov @ slope.T + scaled @ scaled.T
            return (after, cov), (cov, jnp.concatenate([slope, effect], axis=1))

        begin = state, jnp.zeros((states.size, states.size))
        return jax.lax.scan(body, begin, length=SUBSTEPS)[1]

    # Each function is traced once and mapped over all its arguments: that halves the time.
    lengths = jnp.array([0.0, dt, dt / 2, dt / 4])
    walks = jax.vmap(walk)(lengths)
    once, twice = (jax.tree.map(lambda leaf, i=i: leaf[:, i], walks) for i in range(2))
    gaps = jax.vmap(states.boxminus)(_row(once, slice(1, 3)), _row(twice, slice(2, 4)))

    fine = jnp.array([dt, dt / (SUBSTEPS // 2), dt / SUBSTEPS])
    covs, jacobians = jax.vmap(spread)(fine, _stacked([still, control, control]))
    few, many = jnp.diag(covs[1, SUBSTEPS // 2 - 1]), jnp.diag(covs[2, -1])

    def end(shift: Array) -> Any:
        begun = states.boxplus(state, shift[: states.size])
        noise = noises.unflatten(shift[states.size :])
        return model.step(begun, control, noise, fine[1])

    moved = states.boxplus(state, error)
    again = states.boxplus(state, states.boxminus(moved, state))
    return {
        "size": _norm(states.boxminus(state, model.start())),
        "minus of plus": _norm(states.boxminus(moved, state) - error),
        "plus of minus": _norm(states.boxminus(again, moved)),
        "no time": _norm(states.boxminus(_row(once, 0), state)),
        "gap": _norm(gaps[0]),
        "gap of half the step": _norm(gaps[1]),
        "noise": jnp.abs(few - many) - jnp.maximum(few, many) / 4,
        "jacobian": jacobians,
        "slope": _slope_gap(end, states, jacobians[1, 0]),
    }


def _driven(model: Any) -> Array:
    """All values of the states along the default drive."""
    noises = space_of(type(model.noise_density()))
    length = 0.1  # s

    def body(state: Any, time: Array) -> tuple[Any, Array]:
        state = model.step(state, model.drive(time), noises.unflatten(noises.zeros()), length)
        return state, jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(state)])

    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), model.start())
    return jax.lax.scan(body, start, jnp.arange(0.0, SPAN, length))[1]


def _sensor_figures(
    model: Any, reads: Space, outputs: Space, point: Any, error: Float[Array, " m"], target: Any
) -> dict[str, Array]:
    facing = model.facing(target)
    seen = facing.observe(point)

    def look(shift: Array) -> Any:
        return facing.observe(reads.boxplus(point, shift))

    def move(shift: Array) -> Array:
        return outputs.boxminus(look(shift), seen)

    # The same point by its other name: 360 degrees on, or the opposite quaternion.
    other = reads.cls(
        *(
            leaf + 2 * jnp.pi
            if isinstance(c, Circle)
            else -leaf
            if isinstance(c, Rotation)
            else leaf
            for c, leaf in zip(reads.charts, point, strict=True)
        )
    )
    cov, jacobian = facing.noise_cov(point), jax.jacfwd(move)(reads.zeros())
    return {
        "measurement": jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(seen)]),
        "std": outputs.flatten(facing.noise_std(point)),
        "wrap": jnp.abs(outputs.boxminus(outputs.boxplus(seen, error), seen) - error),
        "turn": jnp.abs(outputs.boxminus(facing.observe(other), seen)),
        "cov": jnp.abs(cov),
        "skew": jnp.abs(cov - cov.T),
        "root": cholesky(cov),
        "jacobian": jacobian,
        "slope": _slope_gap(look, outputs, jacobian),
    }


def _slope_gap(
    function: Callable[[Array], Any], values: Space, jacobian: Float[Array, "m n"]
) -> Array:
    """How far a Jacobian at the origin is from central differences, relative to its largest."""
    size = jacobian.shape[1]
    shifts = DIFFERENCE * jnp.concatenate([jnp.zeros((1, size)), jnp.eye(size), -jnp.eye(size)])
    points = jax.vmap(function)(shifts)
    moves = jax.vmap(values.boxminus, (0, None))(points, _row(points, 0))
    slope = (moves[1 : size + 1] - moves[size + 1 :]).T / (2 * DIFFERENCE)
    return jnp.abs(jacobian - slope).max() / jnp.maximum(jnp.abs(slope).max(), 1.0)


def _stacked(trees: list[Any]) -> Any:
    trees = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), trees)
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _norm(vector: Array) -> Array:
    return jnp.sqrt(jnp.sum(vector**2))


def _rigs() -> Iterator[Rig]:
    for name, carried in (("unicycle", "landmarks"), ("constant-velocity", "gnss")):
        vehicle = registry.vehicles.get(name)()
        start, sensor = vehicle.start(), registry.sensors.make(carried)
        prior = Gaussian(start, 0.1 * jnp.eye(space_of(type(start)).size))
        yield Rig(vehicle, (Installation(carried, sensor),), prior)


def _rig_for(model: AbstractFilter, require: _Require) -> Rig:
    refusal = None
    for rig in _rigs():
        try:
            jax.eval_shape(
                lambda key, rig=rig: model.predict(
                    rig.vehicle, model.init(rig.prior, key), rig.vehicle.drive(0.0), 0.1, key
                ),
                jr.key(0),
            )
        except ContractError as error:
            refusal = error
        else:
            return rig
    raise ContractError(f"{require.member} refuses every vehicle: {refusal}") from refusal


def _spoilt(readings: tuple[Readings, ...]) -> tuple[Readings, ...]:
    """Components missing in turn, one infinity, one target that is not on the map."""
    spoilt = []
    for one in readings:
        leaves, structure = jax.tree.flatten(one.measurement)
        for place, leaf in enumerate(leaves):
            flat = np.array(leaf, float)
            for row in range(len(flat)):
                if flat.ndim > 1 and row % 3 == 1:
                    flat[row, row % flat.shape[1]] = np.nan
                elif flat.ndim == 1 and row % 3 == 1 and row // 3 % len(leaves) == place:
                    flat[row] = np.nan
            flat[0] = np.inf
            leaves[place] = flat
        target = np.array(one.target)
        target[2] = -1
        spoilt.append(
            one._replace(measurement=jax.tree.unflatten(structure, leaves), target=target)
        )
    return tuple(spoilt)


def _missing(readings: tuple[Readings, ...]) -> tuple[Readings, ...]:
    return tuple(
        one._replace(
            measurement=jax.tree.map(lambda z: np.full_like(z, np.nan), one.measurement)
        )
        for one in readings
    )


def _online_gap(
    model: AbstractFilter, rig: Rig, log: Log, key: PRNGKeyArray, moments: Any, verdicts: Any
) -> tuple[float, str | None]:
    """The largest difference of an online run from a batch, and the first other verdict."""
    controls, readings = log.controls, log.readings
    count = len(log.schedule.time)
    following = [*range(1, count), count - 1]
    online, worst = Estimator(model, rig, key, control=_row(controls, 0)), 0.0
    for i, (at, fired, place) in enumerate(
        zip(*(part.tolist() for part in log.schedule), strict=True)
    ):
        control = _row(controls, following[i])
        if fired < 0:
            answer = online.push(at, control=control)
        else:
            one = _row(readings[fired], place)
            answer = online.push(
                at,
                rig.sensors[fired].name,
                one.measurement,
                control=control,
                target=int(one.target),
            )
        worst = max(worst, _distance(answer.moments, _row(moments, i)))
        if int(answer.outcome.verdict) != int(verdicts[i]):
            batch = Verdict(int(verdicts[i])).name
            return worst, f"{batch} in the batch, {answer.verdict.name} online, at {at:g} s"
    return worst, None


def _row(tree: Any, index: int | slice) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _distance(one: Gaussian, other: Gaussian) -> float:
    gaps = jax.tree.map(lambda a, b: np.max(np.abs(np.asarray(a) - np.asarray(b))), one, other)
    return float(np.max(jax.tree.leaves(gaps)))


def _bytes(tree: Any) -> list[bytes]:
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree)]

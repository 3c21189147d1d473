"""The contract of a vehicle as a check."""

import functools as ft
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core import registry
from kedge.core.contracts import AbstractVehicle
from kedge.core.manifolds import space_of
from kedge.core.quantities import Scalar
from kedge.numerics.noise import process_std
from kedge.testing.compiling import quick_jit
from kedge.testing.laws import Tracing, member
from kedge.testing.spaces import (
    POINTS,
    charted,
    layout,
    origin_of,
    row,
    slope_gap,
    states_about,
    tangents,
)

SUBSTEPS = 16
SPAN = 60.0  # s


def check_vehicle(vehicle: str | type | AbstractVehicle, dt: float = 0.1) -> None:
    """Check a vehicle against its contract, with steps of ``dt`` s.

    Raises:
        ContractError: the first law that it breaks.
    """
    model, require = member(vehicle, registry.vehicles, AbstractVehicle)
    state, density, control = model.start(), model.noise_density(), model.nominal_control(0.0)
    states = charted(require, "start()", state)
    noises = charted(require, "noise_density()", density, tangent=True)
    controls = charted(require, "nominal_control(0)", control)
    charted(require, "nominal_control(1)", model.nominal_control(1.0), of=type(control))

    deviation = np.asarray(noises.flatten(density))
    require(
        "noise densities are finite and not negative",
        bool(np.isfinite(deviation).all() and (deviation >= 0).all()),
        found=deviation,
    )
    calm = noises.unflatten(noises.zeros())
    with Tracing(require, "step can be traced"):
        after = jax.eval_shape(
            lambda s, u, w, h: model.step(s, u, w, h), state, control, calm, dt
        )
    require(
        "step keeps the structure, the shapes and the dtypes of the state",
        layout(after) == layout(state),
        found=layout(after),
        expected=layout(state),
    )

    def figures(key: PRNGKeyArray) -> dict[str, Any]:
        some, other = jr.split(key)
        points = states_about(states, state, tangents(states, some))
        errors = tangents(states, other, seam=True)
        still = origin_of(controls)
        law = ft.partial(_vehicle_figures, model, still, dt)
        return jax.vmap(law)(points, errors, jnp.linspace(0.0, SPAN, POINTS)) | {
            "drive": _driven(model),
            "points": points,
        }

    with Tracing(require, "step can be differentiated and mapped over states"):
        found = jax.tree.map(np.asarray, quick_jit(figures)(jr.key(1)))

    points = found["points"]
    size = 1e-9 * (1 + found["size"].max())
    require.small(
        "boxminus undoes boxplus, also near half a turn", found["minus of plus"], size
    )
    require.small(
        "boxplus undoes boxminus, also near half a turn", found["plus of minus"], size
    )
    require.small("a step of 0 s changes nothing", found["no time"], 1e-12 * (1 + size), points)
    require.small(
        "two half steps are one step to third order: halving the step leaves 1/6 of the gap",
        found["gap of half the step"],
        found["gap"] / 6 + 1e-12 * (1 + found["size"]),
        points,
    )
    require.small(
        "noise has one variance however time is cut into steps: it acts for dt, is drawn with "
        f"std density / sqrt(dt); within a quarter in {SUBSTEPS // 2} and {SUBSTEPS} steps",
        found["noise"],
        1e-300,
        points,
    )
    require.finite("the Jacobians are finite, also at rest", found["jacobian"], points)
    require.small(
        "the Jacobians are those of central differences", found["slope"], 1e-6, points
    )
    require.finite(f"what nominal_control() does stays finite for {SPAN:g} s", found["drive"])


def _vehicle_figures(
    model: Any, still: Any, dt: float, state: Any, error: Float[Array, " n"], time: Scalar
) -> dict[str, Array]:
    states, noises = space_of(type(state)), space_of(type(model.noise_density()))
    control, calm = model.nominal_control(time), noises.zeros()

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
    gaps = jax.vmap(states.boxminus)(row(once, slice(1, 3)), row(twice, slice(2, 4)))

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
        "no time": _norm(states.boxminus(row(once, 0), state)),
        "gap": _norm(gaps[0]),
        "gap of half the step": _norm(gaps[1]),
        "noise": jnp.abs(few - many) - jnp.maximum(few, many) / 4,
        "jacobian": jacobians,
        "slope": slope_gap(end, states, jacobians[1, 0]),
    }


def _driven(model: Any) -> Array:
    """All values of the states along the default drive."""
    noises = space_of(type(model.noise_density()))
    length = 0.1  # s

    def body(state: Any, time: Array) -> tuple[Any, Array]:
        state = model.step(
            state, model.nominal_control(time), noises.unflatten(noises.zeros()), length
        )
        return state, jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(state)])

    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), model.start())
    return jax.lax.scan(body, start, jnp.arange(0.0, SPAN, length))[1]


def _stacked(trees: list[Any]) -> Any:
    trees = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), trees)
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _norm(vector: Array) -> Array:
    return jnp.sqrt(jnp.sum(vector**2))

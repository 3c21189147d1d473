"""The contract of a sensor as a check."""

import functools as ft
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from kedge.core import registry
from kedge.core.contracts import AbstractSensor
from kedge.core.manifolds import Circle, Rotation, Space
from kedge.estimation.rig import Installation
from kedge.numerics.linalg import cholesky
from kedge.testing.compiling import quick_jit
from kedge.testing.laws import Tracing, member
from kedge.testing.spaces import (
    POINTS,
    charted_class,
    float_name,
    origin_of,
    require_layout,
    slope_gap,
    states_about,
    tangents,
)


def check_sensor(sensor: str | type | AbstractSensor) -> None:
    """Check a sensor against its contract; one with a map, against each of its targets.

    Raises:
        ContractError: the first law that it breaks.
    """
    model, require = member(sensor, registry.sensors, AbstractSensor)
    reads, outputs = (
        charted_class(require, name, getattr(model, name, None))
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

    origin = origin_of(reads)
    targets = Installation("checked", model).targets
    require("its map has a target", targets != 0, found="an empty map")
    with Tracing(require, "observe can be traced"):
        seen = jax.eval_shape(lambda point: model.for_target(0).observe(point), origin)
        noise = jax.eval_shape(lambda point: model.for_target(0).noise_std(point), origin)
    expected = [(chart.shape, float_name()) for chart in outputs.charts]
    require_layout(
        require, "observe returns what measures says", seen, model.measures, expected
    )
    spreads = [(chart.tangent_shape, None) for chart in outputs.charts]
    require_layout(
        require, "noise_std returns what measures says", noise, model.measures, spreads
    )

    def figures(key: PRNGKeyArray) -> dict[str, Array]:
        some, other = jr.split(key)
        points = states_about(reads, origin, 3 * tangents(reads, some))
        errors = tangents(outputs, other, seam=True)
        at = jnp.arange(POINTS) % (targets or 1)
        return jax.vmap(ft.partial(_sensor_figures, model, reads, outputs))(points, errors, at)

    with Tracing(require, "observe can be differentiated and mapped over states"):
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


def _sensor_figures(
    model: Any, reads: Space, outputs: Space, point: Any, error: Float[Array, " m"], target: Any
) -> dict[str, Array]:
    aimed = model.for_target(target)
    seen = aimed.observe(point)

    def look(shift: Array) -> Any:
        return aimed.observe(reads.boxplus(point, shift))

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
    cov, jacobian = aimed.noise_cov(point), jax.jacfwd(move)(reads.zeros())
    return {
        "measurement": jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(seen)]),
        "std": outputs.flatten(aimed.noise_std(point)),
        "wrap": jnp.abs(outputs.boxminus(outputs.boxplus(seen, error), seen) - error),
        "turn": jnp.abs(outputs.boxminus(aimed.observe(other), seen)),
        "cov": jnp.abs(cov),
        "skew": jnp.abs(cov - cov.T),
        "root": cholesky(cov),
        "jacobian": jacobian,
        "slope": slope_gap(look, outputs, jacobian),
    }

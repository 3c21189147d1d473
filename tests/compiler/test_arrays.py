"""Operations on whole arrays: moved, picked, summed, multiplied, factorised, called, repeated.

Their numbers are small and whole, so that every sum and product is exact in any order.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.scipy.linalg import solve_triangular

from compiler.test_elementwise import EXACT
from compiler.test_functions import MEASURED
from fixtures.machine_code import assert_both, by_machine, primitives
from kedge.compiler.graph import Unsupported
from kedge.compiler.interpret import RULES

pytest.importorskip("llvmlite")

M, V, CUBE = (3, 4), (5,), (2, 3, 4)
WHICH, MATRIX = ("i", ()), (4, 4)
FORM = "left_side", "lower", "transpose_a"


@jax.custom_batching.custom_vmap
def doubled(x):
    return 2 * x


@doubled.def_vmap
def _(size, batched, x):
    return 2 * x, batched[0]


@jax.custom_jvp
def tripled(x):
    return 3 * x


tripled.defjvp(lambda x, t: (3 * x[0], 3 * t[0]))


@jax.custom_vjp
def fourfold(x):
    return 4 * x


fourfold.defvjp(lambda x: (4 * x, ()), lambda _, g: (4 * g,))


def reducing(name):
    function = getattr(lax, f"reduce_{name}")
    return [(lambda x, axes=axes: function(x, axes), CUBE) for axes in ((1,), (0, 2))]


def reducing_words(name):
    """On flags, and on words: bit by bit."""
    function = getattr(lax, f"reduce_{name}")
    return [
        (lambda x: function(x.astype(int), (1,)), M),
        (lambda x: function(x > 0, (0,)), M),
        (lambda x: function(x[:, :0].astype(int), (1,)), M),
        (lambda x: function(x[:, :0] > 0, (1,)), M),
    ]


def cumulating(name):
    function = getattr(lax, f"cum{name}")
    return [(lambda x, a=a, r=r: function(x, axis=a, reverse=r), CUBE)
            for a, r in ((0, False), (1, True))]  # fmt: skip


def scattering(how):
    """At one place, at several, in a window, outside, and outside but moved inside."""
    return [
        (lambda x, y: getattr(x.at[2], how)(y[0]), V, V),
        (lambda x, y: getattr(x.at[jnp.array([3, 0, -1])], how)(y[:3]), V, V),
        (lambda x, y: getattr(x.at[1, 1:3], how)(y[0, :2]), M, M),
        (lambda x, y: getattr(x.at[jnp.array([0, 7])], how)(y[:2], mode="drop"), V, V),
        (lambda x, y: getattr(x.at[jnp.array([1, 9])], how)(y[:2], mode="clip"), V, V),
        (lambda x, y: getattr(x.at[:, jnp.array([2, 0])], how)(y[:, :2]), M, M),
    ]


def windows(mode):
    """Windows of two at places of which the last ones stick out."""
    numbers = lax.ScatterDimensionNumbers((1,), (), (0,))

    def scatter(x, y):
        places = jnp.array([[0], [4], [-1]])
        return lax.scatter_add(x, places, y.reshape(3, 2), numbers, mode=mode)

    return (scatter, V, (6,))


def fetching(mode):
    """Slices of three numbers at places of which some lie outside."""
    numbers = lax.GatherDimensionNumbers((1,), (0,), (0, 1))

    def gather(x, i):
        places = jnp.stack([i, i - 3, 2 * i])[:, None] + jnp.array([[0, 1]])
        return lax.gather(x, places, numbers, (1, 3), mode=mode)

    return (gather, M, WHICH)


CASES = {
    "reshape": [(lambda x: x.reshape(6, 4), CUBE), (lambda x: x.reshape(-1), CUBE)],
    "squeeze": [(lambda x: lax.squeeze(x[None, :, :, None], (0, 3)), M)],
    "broadcast_in_dim": [
        (lambda x: jnp.broadcast_to(x, (2, 5)), V),
        (lambda x: lax.broadcast_in_dim(x[0], (3, 4, 2), (1,)), M),
        (lambda x: lax.broadcast_in_dim(x, (3, 7, 4), (0, 2)), M),
        (lambda x: lax.broadcast_in_dim(x[:1], (6, 4), (0, 1)), M),
    ],
    "transpose": [(lambda x: x.transpose(2, 0, 1), CUBE), (lambda x: x.T, M)],
    "rev": [(lambda x: lax.rev(x, (0, 2)), CUBE)],
    "slice": [
        (lambda x: lax.slice(x, (0, 1, 1), (2, 3, 4), (1, 1, 2)), CUBE),
        (lambda x: x[1:1], V),
    ],
    "concatenate": [(lambda x, y: jnp.concatenate([x, y, x], axis=1), M, (3, 2))],
    "stack": [(lambda x, a=a: jnp.stack([x, 2 * x], axis=a), M) for a in (0, 1, -1)],
    "split": [(lambda x: lax.split(x, (1, 3), axis=1), M)],
    "pad": [
        (lambda x: lax.pad(x, 7.0, ((1, 2, 0), (0, 1, 2))), M),
        (lambda x: lax.pad(x, 7.0, ((-1, 2, 1), (3, -2, 0))), M),
    ],
    "iota": [(lambda x, a=a: x[0] + lax.broadcasted_iota(float, (2, 3), a), V) for a in (0, 1)],
    "dynamic_slice": [
        (lambda x, i: lax.dynamic_slice(x, (i, 2 * i), (2, 2)), M, WHICH),
        (lambda x, i: lax.dynamic_slice(2 * x, (i, 1), (2, 2)), M, WHICH),
        (lambda x, i: lax.dynamic_slice(x, (i.astype(jnp.uint8),), (2,)), V, WHICH),
    ],
    "dynamic_update_slice": [
        (lambda x, y, i: lax.dynamic_update_slice(x, y, (i, 2 * i)), M, (2, 2), WHICH),
        (lambda x, y: lax.dynamic_update_slice(x, y, (1, 2)), M, (2, 2)),
    ],
    "gather": [
        (lambda x, i: x[i[None]], M, WHICH),
        (lambda x, i: (2 * x)[i[None, None], ::-1], M, WHICH),
        (lambda x: x[jnp.array([[2, -1], [0, 0]])], M),
        (lambda x, i: x[:, jnp.stack([i, i + 1])], CUBE, WHICH),
        (lambda x, i: jnp.take(x.astype(jnp.int16), i, mode="fill"), V, WHICH),
        (lambda x, i: jnp.take(x > 0, i, mode="fill"), V, WHICH),
        (lambda x, i: jnp.take(x, i, mode="fill", fill_value=9.0), V, WHICH),
        *(fetching(mode) for mode in ("clip", "fill")),
    ],
    "scatter": [
        *scattering("set"),
        (lambda x: x.at[1].apply(lambda y: y * y), V),
    ],
    "scatter-add": [*scattering("add"), windows("drop"), windows("clip")],
    "scatter-sub": scattering("subtract")[:1],
    "scatter-mul": scattering("multiply")[:1],
    "scatter-min": scattering("min")[:1],
    "scatter-max": scattering("max")[:1],
    **{f"reduce_{name}": reducing(name) for name in ("sum", "prod", "max", "min")},
    **{f"reduce_{name}": reducing_words(name) for name in ("and", "or", "xor")},
    **{f"cum{name}": cumulating(name) for name in ("sum", "prod", "max", "min")},
    "argmax": [(lambda x, a=a: lax.argmax(x, a, np.int32), CUBE) for a in (0, 2)],
    "argmin": [(lambda x, a=a: lax.argmin(x, a, np.int64), CUBE) for a in (0, 2)],
    "dot_general": [
        (jnp.dot, M, (4, 2)),
        (jnp.dot, V, V),
        (lambda x, y: jnp.einsum("bij,bjk->bik", x, y), CUBE, (2, 4, 3)),
        (lambda x, y: jnp.einsum("ijk,kj->i", x, y), CUBE, (4, 3)),
        (lambda x, y: jnp.einsum("i,j->ij", x, y), V, V),
        (lambda x, y: x[:, :0] @ y[:0], M, M),
        (lambda x: lax.dot((100 * x).astype(jnp.int8), (x * x).astype(jnp.int8),
                           preferred_element_type=jnp.int32), V),
    ],
    "cholesky": [
        (lambda x: lax.linalg.cholesky(x @ x.T), MATRIX),
        (jnp.linalg.cholesky, MATRIX),
        (jax.vmap(lambda x: lax.linalg.cholesky(x.T @ x + jnp.eye(2))), (3, 5, 2)),
    ],
    "triangular_solve": [
        (lambda a, b, form=form: lax.linalg.triangular_solve(
            a + 9 * jnp.eye(4), b, **dict(zip(FORM, form, strict=True))), MATRIX, MATRIX)
        for form in itertools.product((True, False), repeat=3) if sum(form) % 2
    ] + [(jax.vmap(lambda a, b: solve_triangular(a + 9 * jnp.eye(3), b)), (2, 3, 3), (2, 3))],
    "jit": [(jax.jit(lambda x: 2 * x), V)],
    "custom_jvp_call": [(tripled, V)],
    "custom_vjp_call": [(fourfold, V)],
    "custom_vmap_call": [(doubled, V)],
    "remat2": [(jax.checkpoint(lambda x: 2 * x + 1), V)],
    "platform_index": [
        (lambda x: lax.platform_dependent(x, cpu=lambda y: 2 * y, default=lambda y: 3 * y), V)
    ],
    "cond": [
        (lambda x, i: lax.switch(i, [lambda y: y, lambda y: 2 * y, jnp.square], x), V, WHICH),
        (lambda x, i: lax.cond(i > 1, lambda y: (y, y[0]), lambda y: (-y, 1.0), x), V, WHICH),
        (lambda x: lax.cond(True, lambda y: y, lambda y: -y, x), V),
    ],
    "scan": [
        (lambda x: lax.scan(lambda c, y: (c + y, c * y), 1.0, x), V),
        (lambda x: lax.scan(lambda c, y: (c - 2 * y, y + c), x[0], x, reverse=True), M),
        (lambda x: lax.scan(lambda c, _: (2 * c, c), x, None, length=3), V),
        (lambda x: lax.scan(lambda c, y: (c, y), x, x[:0]), M),
        (lambda x: lax.fori_loop(0, 4, lambda i, c: c + i * c, x), V),
    ],
}  # fmt: skip
"""Operation: functions that use it, each with the shapes of its arguments."""
ROUNDED = {"cholesky", "triangular_solve"}
"""These divide and take roots."""
RENAMED = {"remat2": "checkpoint"}
"""Operations that other versions of JAX call otherwise."""


def drawn(shape, rows, seed):
    rng = np.random.default_rng(seed)
    if shape == WHICH:
        return rng.integers(-2, 6, rows)
    return rng.integers(-3, 4, (rows, *shape)).astype(float)


@pytest.mark.parametrize("name", CASES)
def test_array_operation(name):
    for seed, (function, *shapes) in enumerate(CASES[name]):
        rows = [drawn(shape, 9, seed + 100 * i) for i, shape in enumerate(shapes)]
        used = primitives(jax.make_jaxpr(function)(*[row[0] for row in rows]).jaxpr)
        assert {name, RENAMED.get(name)} & used
        assert_both(function, *rows, signs=False, rounds=name in ROUNDED)


@pytest.mark.parametrize("name", ["reduce_max", "reduce_min", "cummax", "argmax", "argmin"])
def test_extremes_with_nan_and_infinities(name):
    function, *shapes = CASES[name][0]
    rows = drawn(*shapes, 9, 0)
    special = np.random.default_rng(1).choice([np.nan, np.inf, -np.inf, 0.0], rows.shape)
    assert_both(
        function, np.where(np.random.default_rng(2).random(rows.shape) < 0.3, special, rows)
    )


def test_every_rule_is_tested():
    elsewhere = {"convert_element_type", "bitcast_convert_type", "div", "rem"}
    tested = {*EXACT, *MEASURED, *CASES, *elsewhere, *RENAMED.values()}
    assert set(RULES) == tested


@pytest.mark.parametrize(
    "function",
    [
        lambda x, i: lax.sort(x),
        lambda x, i: lax.while_loop(lambda c: c < 3.0, lambda c: c + 1, x[0]),
        lambda x, i: x.at[i].set(0.0),
        lambda x, i: i // i,
        lambda x, i: lax.bitcast_convert_type(x, np.uint32),
        lambda x, i: lax.scan(lambda c, _: (c, c), x, None, length=65),
        lambda x, i: lax.reduce_max(x[:0], (0,)),
    ],
    ids=["sort", "while", "place", "division", "parts", "long", "nothing"],
)
def test_what_has_no_rule_is_said(function):
    """So that the caller lets XLA have the program."""
    with pytest.raises(Unsupported):
        by_machine(function, drawn(V, 4, 0), drawn(WHICH, 4, 1))


def test_what_has_no_rule_is_no_error_where_nobody_looks():
    def function(x):
        lax.sort(x)
        return [x + 1]

    assert_both(function, drawn(V, 4, 0))

"""Passes in parts, as an online estimator does them, and what they leave to the next part."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fixtures.machine_code import RUNS, by_equations
from kedge.compiler.kernel import Kernel
from kedge.compiler.program import Argument, build

pytest.importorskip("llvmlite")
EVENTS, HALF = 8, 3


def loop(xs, start, rate):
    """It carries an array, one that stays as it is, a flag and a count, in this order."""

    def body(carry, x):
        position, rate, above, count = carry
        position = position + rate * x
        carry = position, rate, above | (position[0] > 3), count + (x > 0)
        return carry, position.sum() + count

    first = start, rate, jnp.array(False), jnp.zeros((), int)
    (position, _, above, count), sums = jax.lax.scan(body, first, xs)
    return position, above, count, sums


@pytest.fixture(scope="module", params=[None, RUNS], ids=["one", "several"])
def case(request):
    """The kernel, its arguments and what they should give, for one run and for several."""
    runs = request.param
    rng = np.random.default_rng(5)
    rows = [
        rng.integers(-2, 4, (RUNS, *shape)).astype(float) for shape in ((EVENTS,), (2,), (2,))
    ]
    expected = by_equations(lambda *xs: loop(*xs), *rows)
    if runs is None:
        rows, expected = [row[0] for row in rows], [value[:1] for value in expected]
    traced = jax.make_jaxpr(loop)(*[jax.ShapeDtypeStruct(s, float) for s in ((2,), (2,), (2,))])
    batched = runs is not None
    arguments = [Argument("f8", (2,), batched, number == 0) for number in range(3)]
    return Kernel(build(traced, arguments, batched), batched), runs or 1, rows, expected


def ordered(array, runs):
    return np.moveaxis(array, -1, 1).reshape(-1, array.shape[1])[:runs]


def test_a_pass_in_two_parts_is_the_pass(case):
    kernel, runs, (xs, *fixed), expected = case
    carry, sums = kernel.carry(runs), []
    for part, anew in ((xs[..., :HALF], True), (xs[..., HALF:], False)):
        events = part.shape[-1]
        arrays, outputs = [np.ascontiguousarray(part), *fixed], kernel.fresh(events, runs)
        block = kernel.block(arrays, outputs, carry, events, 0, runs, anew)
        kernel.code.call(block.ctypes.data)
        sums.append(ordered(outputs[0], runs))
    np.testing.assert_array_equal(np.concatenate(sums, axis=1), expected[3])
    # What is left stands where it is said to stand; what nothing changes stands nowhere.
    parts = [kernel.ends[number] for number in range(3)]
    np.testing.assert_array_equal(carry.view(float)[:, parts[0]], expected[0])
    for part, true in zip(parts[1:], expected[1:3], strict=True):
        np.testing.assert_array_equal(carry[:, part].squeeze(1), true)
    assert [kernel.carried[part.start] for part in parts] == ["f8", "b1", "i8"]


def test_cores_share_the_runs(case):
    kernel, runs, rows, expected = case
    outputs = kernel.fresh(EVENTS, runs)
    kernel.run([np.ascontiguousarray(row) for row in rows], outputs, EVENTS, runs)
    np.testing.assert_array_equal(ordered(outputs[0], runs), expected[3])

"""Charts and their product."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError
from kedge.core.manifolds import Circle, Euclidean, Rotation, space, space_of
from kedge.core.quantities import Attitude, Heading, Position, Speed, Velocity3
from kedge.testing import quick_jit


class Everything(NamedTuple):
    position: Position
    heading: Heading
    speed: Speed
    velocity: Velocity3
    attitude: Attitude


SPACE = space_of(Everything)
POINT = Everything(
    jnp.array([1.0, -2.0]),
    jnp.array(3.0),
    jnp.array(0.5),
    jnp.array([0.1, 0.2, 0.3]),
    jnp.array([0.5, 0.5, -0.5, 0.5]),
)


def test_sizes_labels_and_units_belong_together():
    assert SPACE.size == 10
    assert SPACE.labels == (
        *("position_x", "position_y", "heading", "speed"),
        *("velocity_x", "velocity_y", "velocity_z"),
        *("attitude_x", "attitude_y", "attitude_z"),
    )
    assert SPACE.units == ("m", "m", "rad", "m/s", *["m/s"] * 3, *["rad"] * 3)
    for name, part in SPACE.slices().items():
        assert all(label.startswith(name) for label in SPACE.labels[part])
    assert space(POINT) == SPACE


def test_flatten_undoes_unflatten():
    vector = jnp.arange(10.0)
    parts = SPACE.unflatten(vector)
    assert [jnp.shape(part) for part in parts] == [(2,), (), (), (3,), (3,)]
    np.testing.assert_array_equal(SPACE.flatten(parts), vector)


def test_a_field_without_a_chart_is_refused_by_name():
    class Bad(NamedTuple):
        position: Position
        temperature: float

    with pytest.raises(ContractError, match=r"Bad\.temperature has no chart.*e\.g\. Speed"):
        space_of(Bad)


def test_moves_go_by_the_chart():
    moved = quick_jit(SPACE.boxplus)(POINT, np.full(10, 0.2))
    np.testing.assert_allclose(moved.position, [1.2, -1.8])
    np.testing.assert_allclose(moved.heading, 3.2 - 2 * np.pi)
    np.testing.assert_allclose(moved.speed, 0.7)
    np.testing.assert_allclose(np.linalg.norm(moved.attitude), 1)


def test_the_slope_of_a_move_is_the_derivative_of_what_errors_become():
    delta = jnp.array([0.3, -1.0, 4.0, 0.2, 1.0, 2.0, 3.0, 0.7, -1.1, 0.4])

    def seen(error):
        return SPACE.boxminus(SPACE.boxplus(POINT, delta + error), SPACE.boxplus(POINT, delta))

    expected = quick_jit(jax.jacfwd(seen))(jnp.zeros(10))
    np.testing.assert_allclose(SPACE.slope(delta), expected, atol=1e-14)
    flat = space_of(NamedTuple("Flat", [("heading", Heading), ("speed", Speed)]))
    assert flat.slope(jnp.zeros(2)) is None


@pytest.mark.parametrize("chart", [Circle(), Rotation()])
def test_differences_near_half_a_turn(chart):
    """The tangent vector comes back whatever is the point that it starts from."""
    random = np.random.default_rng(1)
    axes = random.normal(size=(40, chart.size))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    gaps = np.repeat([1.0, 1e-3, 1e-6, 1e-9], 10)[:, None]
    tangents = axes * (np.pi - gaps)
    origin = chart.complete(jnp.full(chart.shape, jnp.nan))[0]

    @quick_jit
    @jax.vmap
    def there_and_back(start, tangent):
        base = chart.boxplus(origin, start)
        return chart.boxminus(chart.boxplus(base, tangent), base)

    back = there_and_back(random.normal(size=tangents.shape), tangents)
    np.testing.assert_allclose(back, tangents, atol=1e-14 * np.pi * 10)


def test_exactly_half_a_turn_has_one_difference():
    np.testing.assert_array_equal(Circle().boxminus(jnp.array(jnp.pi), jnp.array(0.0)), -np.pi)
    difference = quick_jit(Rotation().boxminus)
    half = difference(np.array([0.0, 0, 0, 1]), np.array([1.0, 0, 0, 0]))
    np.testing.assert_allclose(np.linalg.norm(half), np.pi)


def test_a_quaternion_and_its_opposite_are_one_attitude():
    q = POINT.attitude
    np.testing.assert_allclose(quick_jit(Rotation().boxminus)(-q, q), 0, atol=1e-15)


def test_rounding_does_not_lengthen_a_quaternion():
    @quick_jit
    def spin(q):
        turn = jnp.array([0.3, -0.2, 0.1])
        return jax.lax.fori_loop(0, 10_000, lambda _, q: Rotation().boxplus(q, turn), q)

    np.testing.assert_allclose(np.linalg.norm(spin(POINT.attitude)), 1, atol=1e-15)


def test_what_is_missing_is_found_by_component():
    seen = Everything(
        jnp.array([jnp.nan, 4.0]), jnp.nan, 1.0, jnp.zeros(3), jnp.array([jnp.nan, 1.0, 0, 0])
    )
    filled, there = quick_jit(SPACE.complete)(seen)
    np.testing.assert_array_equal(there, [0, 1, 0, 1, 1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(filled.position, [0, 4])
    assert filled.heading == 0
    # Three numbers of a quaternion say nothing: it is there as a whole or not at all.
    np.testing.assert_array_equal(filled.attitude, [1, 0, 0, 0])


def test_a_vector_chart_counts_its_components():
    assert (Euclidean("m").size, Euclidean("m", (3,)).size) == (1, 3)

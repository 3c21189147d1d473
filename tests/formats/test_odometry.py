"""Odometry that is told as counts or poses, against the motion that makes them."""

import jax
import jax.numpy as jnp
import numpy as np

from kedge.formats.odometry import counted, driven
from kedge.vehicles.arc import State, along_arc

RANDOM = np.random.default_rng(3)


def test_a_counter_that_flows_over_counts_on():
    steps = RANDOM.integers(-3000, 3000, 200)
    true = np.cumsum(steps) + 65_000
    told = counted({"left": (true % 65_536).astype(float)}, 65_536.0)["left"]
    np.testing.assert_array_equal(told[1:], steps[1:])
    assert told[0] == 0


def test_without_a_counter_a_count_may_be_of_any_size():
    told = counted({"left": np.array([0.0, 1e6, -1e6])}, None)["left"]
    np.testing.assert_array_equal(told, [0, 1e6, -2e6])


def test_ways_between_poses_lead_from_each_to_the_next():
    poses = {
        "position_x": RANDOM.normal(size=50),
        "position_y": RANDOM.normal(size=50),
        "heading": RANDOM.uniform(-np.pi, np.pi, 50),
    }
    ways = driven(poses)
    begun = State(
        jnp.stack([poses["position_x"], poses["position_y"]], axis=1)[:-1],
        jnp.asarray(poses["heading"][:-1]),
    )
    after = jax.vmap(along_arc)(
        begun, *(ways[name][1:] for name in ("forward", "sideways", "yaw_rate"))
    )
    np.testing.assert_allclose(after.position[:, 0], poses["position_x"][1:], atol=1e-12)
    np.testing.assert_allclose(after.position[:, 1], poses["position_y"][1:], atol=1e-12)
    np.testing.assert_allclose(after.heading, poses["heading"][1:], atol=1e-12)

"""Routes: corners and speeds by hand, velocities and yaw rates as derivatives of places."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kedge.core.errors import ContractError
from kedge.simulation.routes import Circle, Facing, FigureOfEight, Lane, Rectangle, Waypoints

SQUARE = ((0.0, 0.0), (0.0, -1.0), (2.0, -1.0), (2.0, 1.0), (0.0, 1.0), (0.0, 0.0))
ROUTES = {
    "trapezoid": Rectangle(),
    "sharp": Rectangle(profile="sharp"),
    "fillet": Rectangle(profile="fillet"),
    "square": Facing(Waypoints(SQUARE, 0.2), (1.0, 0.0)),
    "circle": Facing(Circle((1.0, 0.0)), (1.0, 0.0)),
    "eight": FigureOfEight(),
    "lane": Lane(),
}


@pytest.mark.parametrize("name", ROUTES)
def test_velocity_and_yaw_rate_are_the_derivatives(name):
    route, step = ROUTES[name], 1e-5
    times = np.array(
        [0.313, 7.77, 11.4, 14.2, 17.6, 21.9, 29.8]
    )  # none within a step of a corner
    before, now, after = (jax.vmap(route.at)(times + shift) for shift in (-step, 0.0, step))
    moved = (after.position - before.position) / (2 * step)
    np.testing.assert_allclose(now.velocity, moved, atol=1e-6)
    turned = (after.heading - before.heading + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(now.yaw_rate, turned / (2 * step), atol=1e-6)


def test_the_rectangle_of_the_guided_vehicle():
    """Cruise, corners and times of the protocol: 60 / v + 4 v / 0.3 = 100 s."""
    v = 0.65767
    np.testing.assert_allclose(ROUTES["trapezoid"].driven().speed, v, atol=5e-6)
    side = 20 / v + v / 0.3
    times = np.array([0.0, side, side + 10 / v + v / 0.3, side / 2, 99.999])
    found = jax.vmap(ROUTES["trapezoid"].at)(times)
    wanted = [[0, 0], [20, 0], [20, 10], [10, 0], [0, 0]]
    np.testing.assert_allclose(found.position, wanted, atol=2e-4)
    np.testing.assert_allclose(
        np.linalg.norm(found.velocity, axis=1), [0, 0, 0, v, 0], atol=1e-3
    )

    corner = ROUTES["sharp"].at(50.0)
    np.testing.assert_allclose(corner.position, [20, 10], atol=1e-9)
    np.testing.assert_allclose(corner.velocity, [-0.6, 0], atol=1e-9)
    np.testing.assert_allclose(ROUTES["fillet"].driven().speed, 0.58283, atol=5e-6)
    ahead = ROUTES["fillet"].at((18 + np.pi / 2) / ROUTES["fillet"].driven().speed + 1e-9)
    np.testing.assert_allclose(ahead.position, [20, 1], atol=1e-8)
    np.testing.assert_allclose(ROUTES["fillet"].at(100.0).position, [1, 0], atol=1e-6)


def test_circle_and_square_face_their_landmark():
    start = ROUTES["circle"].at(0.0)
    np.testing.assert_allclose(start.position, [0, 0], atol=1e-12)
    np.testing.assert_allclose(start.velocity, [0, -2 * np.pi / 40], atol=1e-12)
    for name in ("circle", "square"):
        places = jax.tree.map(np.asarray, jax.vmap(ROUTES[name].at)(jnp.linspace(0, 40, 33)))
        away = np.array([1.0, 0.0]) - places.position
        ahead = np.stack([np.cos(places.heading), np.sin(places.heading)], axis=1)
        np.testing.assert_allclose(
            ahead, away / np.linalg.norm(away, axis=1)[:, None], atol=1e-9
        )
    np.testing.assert_allclose(ROUTES["square"].at(10.0).position, [1, -1], atol=1e-12)


def test_the_lane_turns_by_the_area_of_its_trapezoid():
    lane = ROUTES["lane"]
    bends = jax.vmap(lane.bend)(np.array([0.0, 10.5, 14.0, 18.5, 30.0]))
    np.testing.assert_allclose(bends * 800, [0, 0.5, 1, 0.5, 0])
    np.testing.assert_allclose(lane.at(30.0).heading, 40 / 800 * 8, rtol=1e-12)
    # The speed is 40 m/s throughout: so is the length of a finely cut polygon.
    polygon = jax.vmap(lane.at)(jnp.linspace(0, 30, 3001)).position
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(polygon, axis=0), axis=1).sum(), 1200, rtol=1e-6
    )


def test_an_open_list_of_waypoints_ends_in_standing():
    route = Waypoints(((0.0, 0.0), (3.0, 4.0)), 2.0, acceleration=1.0)
    ends = jax.vmap(route.at)(np.array([4.5, 100.0]))
    np.testing.assert_allclose(ends.position, [[3, 4]] * 2, atol=1e-12)
    np.testing.assert_allclose(ends.velocity, np.zeros((2, 2)), atol=1e-12)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: Rectangle(profile="round"),
            "no profile called 'round'",
        ),
        (lambda: Rectangle(lap=20.0), r"no speed takes 20 s .* expected at least 56\.57 s"),
        (lambda: Rectangle(profile="fillet", radius=6.0), "radius is 6 m, expected"),
        (lambda: Waypoints(((0.0, 0.0),)), "two or more points"),
        (lambda: Waypoints(SQUARE, 2.0, 0.5), "shortest side has 1 m, expected .* 8 m"),
        (lambda: Waypoints(SQUARE, -1.0), "speed is -1 m/s"),
    ],
)
def test_refusals(build, message):
    with pytest.raises(ContractError, match=message):
        build()

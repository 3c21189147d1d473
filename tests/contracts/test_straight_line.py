"""The traced step of a Gaussian filter is straight-line code.

One kernel can then be compiled from it that runs many filters in SIMD lanes: static shapes, no
loops but of a few rounds whose number is fixed, no random numbers, no decomposition that is not
unrolled.
"""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import jax.random as jr
import pytest
from jax.extend.core import ClosedJaxpr, Jaxpr

from kedge.compiler.calling import MOST_ROUNDS
from kedge.core import registry
from kedge.core.beliefs import Gaussian
from kedge.core.contracts import AbstractGaussianFilter
from kedge.core.errors import ContractError
from kedge.core.manifolds import space
from kedge.estimation.rig import Installation, check_reads
from kedge.filters.wrappers.gated import Gated
from kedge.vehicles.augmented import Augmented, Drift, augment

GAUSSIAN = [
    name
    for name in registry.filters.names()
    if issubclass(registry.filters.get(name), AbstractGaussianFilter)
]
CROOKED = ("while", "scan", "random", "threefry", "eigh", "svd", "lu", "qr", "erf_inv", "sort")


def primitives(program: Jaxpr) -> Iterator[str]:
    """Names of all primitives, those of inner programs too."""
    for equation in program.eqns:
        # A short one of fixed length is unrolled; XLA compiles it sooner than its rounds.
        if equation.primitive.name != "scan" or equation.params["length"] > MOST_ROUNDS:
            yield equation.primitive.name
        for inner in jax.tree.leaves(
            list(equation.params.values()),
            is_leaf=lambda p: isinstance(p, (Jaxpr, ClosedJaxpr)),
        ):
            if isinstance(inner, (Jaxpr, ClosedJaxpr)):
                yield from primitives(getattr(inner, "jaxpr", inner))


def crooked(function, *arguments) -> set[str]:
    found = set(primitives(jax.make_jaxpr(function)(*arguments).jaxpr))
    return {name for name in found if name.startswith(CROOKED)}


def fitting(state) -> Iterator[Installation]:
    for name in registry.sensors.names():
        # It has to be told the size of the vector that it picks components of.
        told = {"size": space(state).size} if name == "components" else {}
        sensor = Installation(name, registry.sensors.make(name, **told))
        try:
            check_reads(sensor, type(state), "vehicle")
        except ContractError:
            continue
        yield sensor


def vehicle_called(name):
    if name == "augmented":
        return augment(registry.vehicles.make("unicycle"), {"speed_scale": Drift(0.1)}, ())
    # A rule with 3 points an axis has 3^80 on the default ring.
    return registry.vehicles.make(name, **({"size": 4} if name == "lorenz96" else {}))


def pairs() -> Iterator[tuple[str, str]]:
    """Every filter with one vehicle, and every vehicle with one filter of each kind.

    All that a filter does to a vehicle or a sensor is to linearise it or to move sigma points
    through it, so more pairs would find nothing more.
    """
    for name in GAUSSIAN:
        yield name, "unicycle"
    for vehicle in (*registry.vehicles.names(), "augmented"):
        if vehicle != "unicycle":
            yield from (("extended", vehicle), ("unscented", vehicle))


@pytest.mark.parametrize(("name", "vehicle"), list(pairs()))
def test_step_is_straight_line(name, vehicle):
    filter, model = registry.filters.make(name), vehicle_called(vehicle)
    assert isinstance(model, Augmented) == (vehicle == "augmented")
    start, key = model.start(), jr.key(0)
    belief = Gaussian(start, jnp.eye(space(start).size))
    belief = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), belief)
    belief = filter.init(belief, key)
    try:
        found = crooked(
            lambda b: filter.predict(model, b, model.nominal_control(0.0), 0.1, key), belief
        )
    except ContractError as refusal:
        assert name in ("kalman", "gauss-hermite")
        pytest.skip(str(refusal))
    assert not found

    sensors = list(fitting(start))
    assert sensors, f"no sensor fits {vehicle}: its updates cannot be tested"
    for installation in sensors:
        sensor = installation.sensor.for_target(0)
        reading = jax.eval_shape(sensor.expect, start)
        reading = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape), reading)
        try:
            found = crooked(lambda b, z, s=sensor: filter.update(s, b, z, key), belief, reading)
        except ContractError:
            assert name in ("kalman", "gauss-hermite")
            continue
        assert not found, installation.name


def test_the_gate_is_straight_line():
    start, sensor = registry.vehicles.make("unicycle").start(), registry.sensors.make("gnss")
    belief, reading = Gaussian(start, jnp.eye(3)), sensor.measures(jnp.zeros(2))
    key = jr.key(0)
    assert not crooked(lambda b, z: Gated().update(sensor, b, z, key), belief, reading)


def test_the_search_finds_what_is_crooked():
    """It looks into inner programs, and by parts of names: no test that cannot fail."""
    assert {"random_bits", "erf_inv"} <= crooked(lambda key: jr.normal(key, (3,)), jr.key(0))
    assert "while" in crooked(lambda x: jax.lax.fori_loop(0, x, lambda i, c: c + i, 0), 3)
    assert "eigh" in crooked(jax.jit(jnp.linalg.eigh), jnp.eye(3))

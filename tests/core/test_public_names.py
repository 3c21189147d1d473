"""What ``import kedge`` offers, and what it costs."""

import importlib
import os
import subprocess
import sys
from types import ModuleType

import pytest

import kedge
from kedge import filters, simulation, vehicles
from kedge.core import registry
from kedge.core.lazy import names_in
from kedge.testing import stubs


@pytest.mark.parametrize("name", kedge.__all__)
def test_a_public_name_is_there(name):
    assert getattr(kedge, name) is not None


ROOMS = ("calibration", "filters", "positioning", "sensors", "simulation", "vehicles")


@pytest.mark.parametrize("name", [n for n in kedge.__all__ if n not in (*ROOMS, "testing")])
def test_a_public_name_stays_what_it_is(name):
    """Importing a subpackage sets an attribute of the package, which would hide the name."""
    for part in (*ROOMS, "estimation", "evaluation", "studies", "tuning"):
        importlib.import_module(f"kedge.{part}")
    assert not isinstance(getattr(kedge, name), ModuleType)


@pytest.mark.parametrize("room", ROOMS)
def test_the_names_of_a_room_are_there(room):
    module = importlib.import_module(f"kedge.{room}")
    assert len(module.__all__) > 5
    for name in module.__all__:
        assert getattr(module, name) is not None


@pytest.mark.parametrize("room", stubs.ROOMS)
def test_a_stub_lists_what_is_registered(room):
    """If this fails: python -m kedge.testing.stubs, then make format."""
    assert names_in(stubs.stub_file(room)) == stubs.listed(room)


def test_a_class_has_the_name_of_its_registry():
    assert filters.GaussHermite is registry.filters.get("gauss-hermite")
    assert simulation.Circle is registry.routes.get("circle")


def test_a_member_of_somebody_else_is_there_without_a_list():
    class Hover(kedge.AbstractVehicle):
        """Stands."""

    registry.vehicles.add("hover-craft")(Hover)
    try:
        assert vehicles.HoverCraft is Hover
        assert "HoverCraft" in dir(vehicles)
    finally:
        del registry.vehicles._members["hover-craft"]


def test_a_state_says_whose_it_is():
    assert repr(vehicles.Unicycle().start()).startswith("unicycle.State(position=")


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'hovercraft'"):
        getattr(kedge, "hovercraft")  # noqa: B009


def python(code: str, **environment: str) -> str:
    kept = {k: v for k, v in os.environ.items() if not k.startswith("JAX_ENABLE")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**kept, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_import_leaves_jax_alone():
    assert python("import sys, kedge; print('jax' in sys.modules, 'numpy' in sys.modules)") == (
        "False False"
    )


WIDTH = "; import jax.numpy as jnp; print(jnp.zeros(1).dtype)"


@pytest.mark.parametrize(
    ("code", "environment", "dtype"),
    [
        ("import kedge", {}, "float64"),
        ("import jax, kedge", {}, "float64"),
        ("import kedge", {"JAX_ENABLE_X64": "0"}, "float32"),
    ],
)
def test_numbers_have_64_bits_unless_the_user_says_otherwise(code, environment, dtype):
    assert python(code + WIDTH, **environment) == dtype

"""What ``import kedge`` offers, and what it costs."""

import importlib
import os
import subprocess
import sys
from types import ModuleType

import pytest

import kedge


@pytest.mark.parametrize("name", kedge.__all__)
def test_a_public_name_is_there(name):
    assert getattr(kedge, name) is not None


@pytest.mark.parametrize("name", [n for n in kedge.__all__ if n != "__version__"])
def test_a_public_name_stays_what_it_is(name):
    """Importing a subpackage sets an attribute of the package, which would hide the name."""
    for part in ("vehicles", "sensors", "filters", "estimation", "simulation", "evaluation"):
        importlib.import_module(f"kedge.{part}")
    assert not isinstance(getattr(kedge, name), ModuleType)


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

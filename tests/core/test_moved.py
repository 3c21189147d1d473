"""Old import paths name the new ones."""

import importlib
import importlib.util

import pytest

from kedge.core.moved import GONE, moved_modules

MOVED = moved_modules()
ROOMS_BY_THAT_NAME = [
    "kedge.filters.ensemble",
    "kedge.filters.gaussian",
    "kedge.filters.particle",
    "kedge.vehicles.underwater",
]


@pytest.mark.parametrize("old", sorted(MOVED))
def test_an_old_module_names_the_new_one(old):
    assert importlib.util.find_spec(MOVED[old]) is not None
    if old in ROOMS_BY_THAT_NAME:
        return
    with pytest.raises(ImportError, match=f"{old} is now {MOVED[old]}"):
        importlib.import_module(old)


def test_a_module_of_a_package_that_is_no_more():
    with pytest.raises(ImportError, match=r"kedge.files.tables is now kedge.formats.tables"):
        from kedge.files import tables  # noqa: F401


@pytest.mark.parametrize("package", GONE)
def test_a_package_that_is_no_more_names_what_took_its_place(package):
    module = importlib.import_module(package)
    with pytest.raises(AttributeError, match=GONE[package].split()[0]):
        _ = module.nothing


def test_a_module_that_never_was_is_not_found():
    with pytest.raises(ModuleNotFoundError, match=r"kedge.evaluation.hovercraft"):
        importlib.import_module("kedge.evaluation.hovercraft")

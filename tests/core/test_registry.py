"""Names to classes: found without a list, refused with a hint."""

from pathlib import Path

import pytest

import kedge.filters
import kedge.sensors
import kedge.vehicles
from kedge.core import registry
from kedge.core.errors import ContractError, UnknownName
from kedge.core.registry import Registry, unknown

FAMILIES = {
    registry.vehicles: kedge.vehicles,
    registry.sensors: kedge.sensors,
    registry.filters: kedge.filters,
}


def test_a_name_that_does_not_exist_is_answered_with_the_nearest():
    with pytest.raises(UnknownName, match=r"no vehicles called 'unicicle' \(did you mean 'uni"):
        registry.vehicles.get("unicicle")


def test_a_name_that_resembles_none_is_answered_with_all():
    with pytest.raises(UnknownName) as error:
        registry.filters.get("zzz")
    assert "did you mean" not in str(error.value)
    assert all(name in str(error.value) for name in registry.filters.names())


def test_a_parameter_that_does_not_exist_is_answered_with_the_nearest():
    with pytest.raises(UnknownName, match=r"parameter of 'ensemble'.*'cuont'.*mean 'count'"):
        registry.filters.make("ensemble", cuont=50)
    assert registry.filters.make("ensemble", count=50).count == 50


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.family)
def test_every_file_of_a_family_is_found(family):
    folder = FAMILIES[family].__path__[0]
    files = {
        path.stem
        for path in Path(folder).glob("*.py")
        if f"@{family.family}.add(" in path.read_text()
    }
    homes = {family.get(name).__module__.rpartition(".") for name in family.names()}
    # A test beside this one may have registered a user's own.
    assert files == {home for package, _, home in homes if package == FAMILIES[family].__name__}


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.family)
def test_names_and_classes_are_one_to_one(family):
    for name in family.names():
        assert family.name_of(family.get(name)) == name


def test_two_classes_cannot_share_a_name():
    family = Registry("vehicles")
    family.add("boat")(type("Boat", (), {}))
    with pytest.raises(ContractError, match=r"two vehicles are called 'boat'.*Ship"):
        family.add("boat")(type("Ship", (), {}))


def test_a_file_that_is_loaded_again_replaces_itself():
    family = Registry("vehicles")
    again = type("Boat", (), {})
    family.add("boat")(type("Boat", (), {}))
    assert family.add("boat")(again) is again


def test_installed_entry_points_are_members(monkeypatch):
    family = Registry("vehicles")

    class Point:
        def load(self):
            family.add("hovercraft")(type("Hovercraft", (), {}))

    monkeypatch.setattr(
        registry, "entry_points", lambda group: [Point()] if group == "kedge.vehicles" else []
    )
    assert "hovercraft" in family.names()


def test_a_name_in_another_case_is_the_nearest():
    """By letters alone "X" is as far from "x" as from any other."""
    text = unknown("column", "X", ["y", "x", "stamp"])
    assert "did you mean 'x'?" in text
    assert "did you mean 'time'?" in unknown("column", "TIME", ["tIMES", "time"])

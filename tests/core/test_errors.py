"""One base class for everything that is raised on purpose, and nothing else under it."""

import inspect

import pytest

from kedge.core import errors
from kedge.core.errors import KedgeError

TREE = [cls for _, cls in inspect.getmembers(errors, inspect.isclass)]


@pytest.mark.parametrize("cls", TREE)
def test_catching_the_base_catches_all(cls):
    assert issubclass(cls, KedgeError)
    assert not issubclass(cls, (ValueError, KeyError))


def test_the_drawing_shows_the_whole_tree():
    for cls in TREE:
        assert cls.__name__ in errors.__doc__

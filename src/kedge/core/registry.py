"""Tables of classes, and of functions that read logs, by name: filled by decorators.

A module dropped into ``kedge/vehicles``, ``kedge/sensors``, ``kedge/filters``,
``kedge/positioning`` (whose fix is a filter too), for worlds, routes and faults into
``kedge/simulation``, for readers into ``kedge/datasets``, or into a folder in one of them, is
imported on first use, and so is every installed entry point of group ``kedge.<family>``. There
is no list to edit.
"""

import dataclasses
import difflib
import importlib
import pkgutil
import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, Generic

from typing_extensions import TypeVar

from kedge.core.errors import ContractError, UnknownName

T = TypeVar("T", default=Any)
Member = TypeVar("Member", bound=Callable[..., Any])


class Registry(Generic[T]):
    """The members of one family, defined in the modules of its ``packages``."""

    def __init__(self, family: str, *packages: str):
        self.family, self.packages = family, packages or (f"kedge.{family}",)
        self._members: dict[str, Any] = {}
        self._complete = False

    def add(self, name: str) -> Callable[[Member], Member]:
        """Decorator that registers a class, or a reader's function, under ``name``.

        Raises:
            ContractError: the name is taken by another member.
        """

        def register(cls: Member) -> Member:
            taken = self._members.get(name)
            # The same file imported twice (a notebook cell, a reload) replaces itself.
            if taken is not None and taken.__qualname__ != cls.__qualname__:
                raise ContractError(
                    f"two {self.family} are called {name!r}: {taken.__module__}."
                    f"{taken.__qualname__} and {cls.__module__}.{cls.__qualname__}"
                )
            self._members[name] = cls
            _name_owner(cls)
            return cls

        return register

    def get(self, name: str) -> T:
        """Look a member up.

        Raises:
            UnknownName: with the names that do exist.
        """
        if name not in self._members:
            self._discover()
        try:
            return self._members[name]
        except KeyError:
            raise UnknownName(unknown(self.family, name, self.names())) from None

    def make(self, name: str, **parameters: Any) -> Any:
        """An instance of a member, with the parameters given.

        Raises:
            UnknownName: there is no such member, or it has no such parameter.
        """
        cls: Any = self.get(name)
        known = [field.name for field in dataclasses.fields(cls)]
        for key in parameters:
            if key not in known:
                raise UnknownName(unknown(f"parameter of {name!r}", key, known))
        return cls(**parameters)

    def __contains__(self, name: str) -> bool:
        """Whether there is a member of that name."""
        if name not in self._members:
            self._discover()
        return name in self._members

    def names(self) -> list[str]:
        """The registered names, sorted."""
        self._discover()
        return sorted(self._members)

    def by_class_name(self, name: str) -> type[T]:
        """The member registered as ``my-robot``, asked for as ``MyRobot``.

        Raises:
            UnknownName: with the names that do exist.
        """
        known = {camel_case(member): member for member in self.names()}
        if name not in known:
            raise UnknownName(unknown(self.family, name, list(known)))
        return self._members[known[name]]

    def name_of(self, cls: type) -> str:
        """The name under which ``cls`` is registered; else what the class is called."""
        return next((n for n, member in self._members.items() if member is cls), cls.__name__)

    def _discover(self) -> None:
        if self._complete:
            return
        self._complete = True
        for name in self.packages:
            package = importlib.import_module(name)
            for module in pkgutil.walk_packages(package.__path__, f"{name}."):
                importlib.import_module(module.name)
        for point in entry_points(group=f"kedge.{self.family}"):
            point.load()


def camel_case(name: str) -> str:
    """The public name of a member: ``gauss-hermite`` is ``GaussHermite``."""
    return "".join(part[:1].upper() + part[1:] for part in name.split("-"))


def _name_owner(member: Callable[..., Any]) -> None:
    """Have the ``NamedTuple`` classes of a member's module say whose they are.

    There is a ``State`` in every module of a vehicle: it shows as ``unicycle.State(...)``.
    """
    module = sys.modules.get(member.__module__)
    values: list[Any] = [] if module is None else list(vars(module).values())
    for cls in values:
        if (
            isinstance(cls, type)
            and issubclass(cls, tuple)
            and hasattr(cls, "_fields")
            and cls.__module__ == member.__module__
        ):
            cls.__repr__ = _owned_repr


def _owned_repr(self: Any) -> str:
    """``unicycle.State(position=..., heading=...)``."""
    cls: type[Any] = type(self)
    fields = ", ".join(f"{name}={part!r}" for name, part in self._asdict().items())
    return f"{cls.__module__.rpartition('.')[2]}.{cls.__qualname__}({fields})"


LONGEST = 60
"""Letters that a message quotes of a name."""


def unknown(kind: str, name: str, known: list[str]) -> str:
    """The sentence for a name that does not exist: the nearest first, then all."""
    near = [other for other in known if other.casefold() == name.casefold()]
    near = near or difflib.get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    name = name if len(name) <= LONGEST else f"{name[:LONGEST]}..."
    return f"no {kind} called {name!r}{hint}; there are {', '.join(known) or 'none'}"


vehicles: Registry = Registry("vehicles")
sensors: Registry = Registry("sensors")
filters: Registry = Registry("filters", "kedge.filters", "kedge.positioning")
worlds: Registry = Registry("worlds", "kedge.simulation")
routes: Registry = Registry("routes", "kedge.simulation")
faults: Registry = Registry("faults", "kedge.simulation")
readers: Registry = Registry("readers", "kedge.datasets", "kedge.formats")

make_vehicle = vehicles.make
make_sensor = sensors.make
make_filter = filters.make

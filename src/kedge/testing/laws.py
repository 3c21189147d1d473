"""Laws, and what is said of a member that breaks one."""

from typing import Any, NamedTuple

import numpy as np

from kedge.core import registry
from kedge.core.errors import ContractError


class Require:
    """Raises unless a law holds; knows whose contract it is."""

    def __init__(self, member: str):
        self.member = member

    def __call__(self, law: str, holds: bool, found: Any, expected: Any = None) -> None:
        if not holds:
            wanted = "" if expected is None else f"; expected {expected}"
            raise ContractError(f"{self.member} breaks the law '{law}': found {found}{wanted}")

    def small(self, law: str, values: Any, bound: Any, states: Any = None) -> None:
        """No value is beyond its bound, and none is NaN.

        ``states`` are those at which the values were found, along their first axis.
        """
        values, bound = np.broadcast_arrays(np.asarray(values), np.asarray(bound))
        excess = np.where(np.isfinite(values), values - bound, np.inf)
        worst = np.unravel_index(np.argmax(excess), excess.shape)
        holds = bool((excess <= 0).all())
        place = _at(states, int(worst[0])) if worst else ""
        self(law, holds, f"{values[worst]:.3g}{place}", f"at most {bound[worst]:.3g}")

    def finite(self, law: str, values: Any, states: Any = None) -> None:
        """All values are finite; ``states`` as above."""
        bad = ~np.isfinite(values)
        place = _at(states, int(np.argwhere(bad)[0][0])) if bad.any() and bad.ndim else ""
        found = f"{np.count_nonzero(bad)} of {np.size(values)} values that are not{place}"
        self(law, not bad.any(), found, "none")


def _at(states: Any, index: int) -> str:
    """The state at which a law is broken, and how to say that the vehicle never gets there."""
    if states is None:
        return ""
    fields = states._asdict().items()
    values = (
        f"{name}={np.round(np.asarray(leaf)[index], 4).tolist()}" for name, leaf in fields
    )
    return (
        f" at the state {', '.join(values)} (if it cannot get there, say so in the state: "
        "Annotated[SteeringAngle, Within(-0.6, 0.6)])"
    )


class Tracing(NamedTuple):
    """Turns what a member raises into a ``ContractError`` that says when."""

    require: Require
    law: str

    def __enter__(self) -> None: ...

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, Exception):
            first = str(error).strip().splitlines() or [""]
            found = f"{type(error).__name__}: {first[0]}"
            raise ContractError(
                f"{self.require.member} breaks the law '{self.law}': found {found}"
            ) from error


def member(given: Any, family: registry.Registry, base: type) -> tuple[Any, Require]:
    """An instance of the member with its defaults, and the one who complains about it."""
    if isinstance(given, base):
        cls, label = type(given), type(given).__name__
    else:
        cls = family.get(given) if isinstance(given, str) else given
        label = f"{given!r} ({cls.__name__})" if isinstance(given, str) else cls.__name__
    require = Require(f"{family.family[:-1]} {label}")
    require(f"it is an {base.__name__}", issubclass(cls, base), cls.__mro__[1].__name__)
    require(
        "its docstring has a Source",
        "Source:" in (cls.__dict__.get("__doc__") or ""),
        found="none",
        expected="'Source: author, title, year, section'",
    )
    if isinstance(given, base):
        return given, require
    try:
        return cls(), require
    except TypeError as error:
        raise ContractError(
            f"{require.member} breaks the law 'it can be made without arguments': {error}; "
            "give every field a default and define every abstract method"
        ) from error

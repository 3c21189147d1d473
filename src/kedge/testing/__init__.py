"""The contracts as checks, for kedge's own members and for anybody's.

A test that calls ``check_vehicle("my-vehicle")`` (or passes the class, or an instance) is all
that a new vehicle, sensor or filter needs. Each check raises a ``ContractError`` that names the
law, what was found and what was expected. Every check compiles its member once and then tries
it at many random points; the seeds are fixed, so that what passes keeps passing.
"""

from kedge.testing.compiling import quick_jit
from kedge.testing.filters import check_filter
from kedge.testing.sensors import check_sensor
from kedge.testing.vehicles import check_vehicle

__all__ = ["check_filter", "check_sensor", "check_vehicle", "quick_jit"]

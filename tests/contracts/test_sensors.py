"""Every registered sensor keeps its contract; new ones are found without being named.

That its Jacobian is that of central differences (law 10) is part of the contract.
"""

import pytest

from kedge.core import registry
from kedge.testing import check_sensor


@pytest.mark.parametrize("name", registry.sensors.names())
def test_sensor(name):
    check_sensor(name)

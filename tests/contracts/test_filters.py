"""Every registered filter keeps its contract; new ones are found without being named.

Among it: batch and online agree to 1e-9, with readings that are spoilt in every way.
"""

import pytest

from kedge.core import registry
from kedge.testing import check_filter


@pytest.mark.parametrize("name", registry.filters.names())
def test_filter(name):
    check_filter(name)

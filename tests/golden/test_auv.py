"""Paper C's experiment: figures of an independent program, and what its claims come to."""

import pytest

from kedge.apps.study import Options, execute
from kedge.evaluation.study_claims import FALSE, OPEN, TRUE

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:fuzzy. box")]


def test_a_wrong_start_is_forgotten_as_the_gains_say():
    options = Options(filters="raw,kf-literal,kf,enkf-100", runs=20)
    found = execute("auv-turning", options)
    assert [band["verdict"] for band in found["expected"]] == [TRUE] * 3
    assert [claim["verdict"] for claim in found["claims"]] == [OPEN, FALSE]

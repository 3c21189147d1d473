"""Paper C's experiment: figures of an independent program, and what its claims come to."""

import pytest

from kedge.apps.study import Options, execute
from kedge.evaluation.record import record
from kedge.studies.claims import FALSE, OPEN, TRUE

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:fuzzy. the box")]


def verdicts(entries, filters):
    """Of those that are about these filters only."""
    names = filters.split(",")
    return [
        entry["verdict"] for entry in entries if entry["score"].partition(".rmse")[0] in names
    ]


def test_a_wrong_start_is_forgotten_as_the_gains_say():
    filters = "raw,kinematic,kf-literal,kf,enkf-100"
    found = record(execute("auv-turning", Options(filters=filters, runs=20)))
    assert verdicts(found["expected"], filters) == [TRUE] * 5
    # The fuzzy filter is left out here: it takes longer than all others together.
    assert [claim["verdict"] for claim in found["claims"]] == [OPEN, FALSE]


def test_the_published_predictor_is_wrong_where_the_model_is_right():
    """P1d: to predict by the model is 10 times better than to count its forces twice."""
    filters = "raw,kf,fuzzy,extended,enkf-100"
    found = record(execute("auv-dynamics", Options(filters=filters, runs=8)))
    assert verdicts(found["expected"], filters) == [TRUE] * 5
    assert [claim["verdict"] for claim in found["claims"]] == [TRUE, TRUE]

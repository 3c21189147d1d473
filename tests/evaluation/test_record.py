"""Scores as JSON: one set of rules for the keys, their dotted names and their schema."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import jsonschema
import pytest

from kedge.evaluation.record import by_name, record, schema
from kedge.evaluation.scores import ResidualScore, Score, TargetScores


@dataclass(frozen=True)
class Part:
    """Some of it."""

    rmse: Mapping[str, Score]
    """By field.

    In SI units.
    """
    nees: Score


@dataclass(frozen=True)
class Whole:
    """All of it."""

    part: Part = field(metadata={"inline": True})
    count: int
    stretches: tuple[tuple[float, float], ...]
    parts: Mapping[str, Part]
    seconds: float | None = None
    others: Mapping[str, float] = field(default_factory=dict)


PART = Part({"position": Score(1.0, 0.5, 1.5)}, Score(math.nan))
WHOLE = Whole(PART, 3, ((0.0, 1.0),), {"late": PART})


def test_a_score_has_its_interval_beside_it():
    part = {
        "rmse": {"position": 1.0},
        "rmse_ci": {"position": [0.5, 1.5]},
        "nees": pytest.approx(math.nan, nan_ok=True),
        "nees_ci": [pytest.approx(math.nan, nan_ok=True)] * 2,
    }
    stretches = [[0.0, 1.0]]
    assert record(WHOLE) == part | {"count": 3, "stretches": stretches, "parts": {"late": part}}
    assert record({"a": PART})["a"]["rmse"] == {"position": 1.0}


def test_a_mapping_among_the_fields_of_its_owner_may_be_empty():
    targets = {"a": TargetScores(2, 1, {})}
    assert record(targets) == {"a": {"readings": 2, "gated": 1}}
    residual = {"range": ResidualScore(0.0, 1.0, 0.5)}
    target = record(TargetScores(2, 1, residual))
    assert target["range"] == {"median": 0.0, "spread": 1.0, "standardised": 0.5}


def test_numbers_have_dotted_names_and_intervals():
    numbers = by_name(WHOLE)
    assert set(numbers) == {
        "rmse.position", "nees", "count", "parts.late.rmse.position", "parts.late.nees",
    }  # fmt: skip
    assert numbers["parts.late.rmse.position"] == (1.0, 0.5, 1.5)
    assert numbers["count"] == (3.0, 3.0, 3.0)


def test_the_schema_takes_what_is_written_and_nothing_else():
    whole = schema("a whole", Whole)
    jsonschema.Draft202012Validator.check_schema(whole)
    value = json.loads(json.dumps(record(WHOLE)).replace("NaN", "null"))
    jsonschema.validate(value, whole)
    jsonschema.validate(value | {"seconds": 1.5, "others": {"a": None}}, whole)
    about = whole["$defs"]["Whole"]["properties"]["rmse"]["description"]
    assert about == "By field. In SI units."
    for wrong in (
        value | {"strange": 1},
        value | {"count": 1.5},
        value | {"rmse_ci": {"position": [0.5]}},
        {key: entry for key, entry in value.items() if key != "nees_ci"},
    ):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, whole)

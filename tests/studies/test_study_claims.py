"""Claims are read, never executed, and judged by intervals."""

import jax.numpy as jnp
import numpy as np
import pytest

from kedge.config.published import ClaimConfig
from kedge.core.beliefs import Gaussian
from kedge.core.conditions import Comparison, Term, parse_condition, parse_term
from kedge.core.errors import ConfigError
from kedge.estimation.rig import Rig
from kedge.simulation.scenario import Scenario
from kedge.studies.claims import FALSE, OPEN, TRUE, Evidence, judge, judge_band, judge_claim
from kedge.studies.scores import Result, RunScores, TimeSums
from kedge.studies.study import Study
from kedge.studies.summary import summarise_study
from kedge.vehicles.constant_velocity import ConstantVelocity


@pytest.fixture(scope="module")
def evidence():
    """300 runs: "other" is 5 % worse than "kalman" in each, which spread by far more."""
    vehicle = ConstantVelocity()
    rig = Rig(vehicle, (), Gaussian(vehicle.start(), jnp.eye(4)))
    study = Study(Scenario(rig, 10.0, 1.0))
    hard = np.random.default_rng(0).chisquare(1, 300)
    noise = np.random.default_rng(1).normal(1, 0.1, 300)
    once, none = np.ones(300), np.zeros((300, 0))
    nothing, by_time, by_reading = np.zeros(()), np.zeros(10), np.zeros(0)
    sums = TimeSums(nothing, np.zeros((10, 4)), by_time, *[by_reading] * 3)

    def result(squared, seconds):
        squared = np.repeat(squared[:, None], 4, 1)
        inside = np.ones((300, 4))
        runs = RunScores(
            once, squared, 4 * noise, once, inside, none, none, none, 0 * once, none
        )
        return Result(runs, runs, sums, seconds)

    results = {
        "kalman": result(hard, 1.0),
        "other:a=1.05": result(1.05**2 * hard * noise, 3.0),
        "twin": result(hard, 2.0),
    }
    return Evidence(study, results, summarise_study(study, results))


def test_conditions_are_read():
    dotted = "etkf:count=10,inflation=1.02"
    found = parse_condition(f"{dotted}.ratio >= 1.0 and kalman.rmse.position < {dotted}.score")
    assert found == (
        Comparison(Term(dotted, "ratio"), ">=", 1.0),
        Comparison(Term("kalman", "rmse.position"), "<", Term(dotted, "score")),
    )
    assert parse_term("kalman.all_steps.nis.gnss-1") == Term("kalman", "all_steps.nis.gnss-1")
    assert parse_condition("kalman.nees <= -1.5e-3")[0].right == -0.0015
    (half,) = parse_condition("kalman.score < 0.5 * twin.score")
    assert half == Comparison(Term("kalman", "score"), "<", Term("twin", "score"), 0.5)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "kalman.rmse.position",
        "kalman.rmse.position=1",
        "kalman.best <= 1",
        "1 <= kalman.nees",
        "kalman.nees <= much * twin.nees",
        "kalman.nees <= 2* twin.nees * 3",
        "kalman.nees <= 1 or kalman.nees >= 2",
        "kalman.nees <= __import__('os').getcwd()",
        "kalman.__class__ <= 1",
    ],
)
def test_nothing_else_is(text):
    with pytest.raises(ConfigError, match="found"):
        parse_condition(text)


@pytest.mark.parametrize(
    ("test", "verdict"),
    [
        ("other:a=1.05.ratio > 1.0", TRUE),
        ("other:a=1.05.ratio < 1.0", FALSE),
        ("other:a=1.05.ratio < 1.05", OPEN),
        # The intervals of the scores overlap widely; in pairs the runs tell them apart.
        ("kalman.rmse.position < other:a=1.05.rmse.position", TRUE),
        ("kalman.score > other:a=1.05.score", FALSE),
        ("twin.score <= kalman.score and twin.score >= kalman.score", TRUE),
        ("kalman.seconds <= twin.seconds", TRUE),
        ("other:a=1.05.score <= 1.2 * kalman.score", TRUE),
        ("other:a=1.05.score >= 1.2 * kalman.score", FALSE),
        ("twin.seconds <= 2 * kalman.seconds", TRUE),
        ("twin.seconds <= 1.9 * kalman.seconds", FALSE),
        ("kalman.nees <= 3.0", FALSE),
        ("kalman.nees > 3.5 and kalman.nees < 3.9", FALSE),
        ("extended.ratio <= 1.0", OPEN),
        ("kalman.rmse.altitude <= 1.0", OPEN),
        ("kalman.nis.gnss <= 1.0", OPEN),
    ],
)
def test_verdicts(evidence, test, verdict):
    assert judge(test, evidence).verdict == verdict


def test_verdicts_say_why(evidence):
    found = judge("other:a=1.05.score < kalman.score", evidence)
    assert found.figures.startswith("other:a=1.05 / kalman: score ratio 1.0")
    assert "extended is not among" in judge("extended.nees < 1", evidence).figures
    assert (
        "no score called rmse.altitude" in judge("kalman.rmse.altitude < 1", evidence).figures
    )


def test_bands(evidence):
    value = evidence.filters["kalman"].score.value
    _, low, high = evidence.filters["kalman"].score
    assert judge_band("kalman.score", [0.9 * value, 1.1 * value], evidence).verdict == TRUE
    assert judge_band("kalman.score", [(value + high) / 2, 2.0], evidence).verdict == OPEN
    assert judge_band("kalman.score", [1.1 * high, 2 * high], evidence).verdict == FALSE
    assert judge_band("kalman.score", [0.0, 0.9 * low], evidence).verdict == FALSE


def test_a_claim_is_judged_under_its_own_settings(evidence):
    """Elsewhere it is not tested; what it means stands under no verdict but its own."""
    loop = {"scenario.feedback": "none"}
    claim = ClaimConfig(
        text="Worse.", source="s", test="other:a=1.05.score > kalman.score", under=loop,
        outcome="true", means="By a twentieth.",
    )  # fmt: skip
    judged = judge_claim(claim, evidence, {"scenario": {"feedback": "none"}})
    assert (judged.verdict, judged.means) == (TRUE, "By a twentieth.")
    steered = judge_claim(claim, evidence, {"scenario": {"feedback": "filter"}})
    assert (steered.verdict, steered.means) == (OPEN, "")
    assert "not tested here: scenario.feedback is 'filter'" in steered.figures
    other = claim.model_copy(update={"outcome": "false"})
    assert judge_claim(other, evidence, {"scenario": {"feedback": "none"}}).means == ""
    with pytest.raises(ConfigError, match=r"under: found 'scenario.feedback'"):
        judge_claim(claim, evidence, {})

"""Studies of closed loops: each filter in the loop that it closes, or all in one."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from kedge.core.beliefs import Gaussian
from kedge.core.errors import ContractError
from kedge.estimation.rig import Installation, Rig
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.kalman import Kalman
from kedge.sensors.tracking_error import TrackingError
from kedge.simulation.scenario import LoopFilter, Scenario
from kedge.simulation.simulate import simulate
from kedge.simulation.worlds.lane_keeping import LaneKeeping
from kedge.studies.scores import Tally, pack, unpack
from kedge.studies.study import Study
from kedge.studies.trials import Trials, run_study, stream
from kedge.vehicles.lateral_tracking import LateralTracking, LinearLateralTracking
from kedge.vehicles.unicycle import Unicycle

CAR = LateralTracking()
PRIOR = Gaussian(CAR.start(), jnp.diag(jnp.array([0.1, 0.05, 0.5, 0.02, 0.5]) ** 2))
RIG = Rig(CAR, (Installation("camera", TrackingError(), rate=25.0),), PRIOR)
SCENARIO = Scenario(RIG, duration=2.0, dt=0.02, world=LaneKeeping(), feedback="filter")
LINEAR = {"kalman": LinearLateralTracking()}


@pytest.fixture(scope="module")
def own():
    """Each filter in a loop of its own."""
    study = Study(SCENARIO, start="truth", seed=4, vehicles=LINEAR)
    trials = Trials(study, {"extended": ExtendedKalman(), "kalman": Kalman()}, 2)
    return study, trials.part(0)


@pytest.mark.slow
def test_each_filter_has_a_truth_of_its_own_with_the_same_draws(own):
    _, part = own
    first, second = (part.pieces[name] for name in ("extended", "kalman"))
    gap = first.track["offset"] - second.track["offset"]
    # Their models differ by r v_y only, which hardly moves the estimates.
    assert 1e-9 < np.abs(gap).max() < 0.02
    assert np.abs(first.whole.tracked - second.whole.tracked).max() < 1e-2
    np.testing.assert_array_equal(part.truth["offset"], first.track["offset"])


@pytest.mark.slow
def test_what_a_filter_is_scored_on_is_what_was_steered_by(own):
    """The last command follows from the scored estimate before it, in the scored truth."""
    study, part = own
    run = jr.fold_in(stream(4, "truth"), 0)
    pilot = LoopFilter(
        Kalman(),
        key=jr.fold_in(stream(4, "filter kalman"), 0),
        error=jr.normal(jr.fold_in(stream(4, "prior"), 0), (5,)),
    )
    scenario = dataclasses.replace(study.scenario_of("kalman"), loop_filter=pilot)
    again = simulate(scenario, run)
    piece = part.pieces["kalman"]
    np.testing.assert_allclose(again.truth.offset, piece.track["offset"], atol=1e-9)
    steer = jax.jit(LaneKeeping().guidance(scenario))
    believed = type(CAR.start())(**{k: jnp.asarray(v[-2]) for k, v in piece.example.items()})
    np.testing.assert_allclose(
        again.controls.steering[-1], steer(believed, 1.98).steering, rtol=1e-6
    )
    squared = np.mean(np.asarray(again.truth.offset) ** 2)
    np.testing.assert_allclose(piece.whole.tracked[0, 0], squared, rtol=1e-6)


@pytest.mark.slow
def test_all_filters_in_the_loop_of_one(own):
    """The truth is that of the filter named, and so are the estimates under its name."""
    pilot = LoopFilter(ExtendedKalman(), "extended")
    scenario = dataclasses.replace(SCENARIO, loop_filter=pilot)
    study = dataclasses.replace(own[0], scenario=scenario)
    filters = {"kalman": Kalman(), "extended": ExtendedKalman()}
    part = Trials(study, filters, 2).part(0)
    first, second = part.pieces.values()
    np.testing.assert_array_equal(first.track["offset"], second.track["offset"])
    alone = own[1].pieces["extended"]
    np.testing.assert_allclose(second.runs.squared, alone.runs.squared, rtol=1e-6)
    np.testing.assert_allclose(second.whole.tracked, alone.whole.tracked, rtol=1e-6)
    tally = Tally(list(filters))
    tally.add(unpack(pack(part), list(filters)))
    np.testing.assert_array_equal(
        tally.results()["kalman"].track["offset"], first.track["offset"]
    )


def test_a_motion_model_of_another_kind_is_refused():
    other = Study(SCENARIO, vehicles={"kalman": Unicycle()})
    with pytest.raises(ContractError, match="'kalman': its Unicycle is driven by"):
        run_study(other, {"kalman": Kalman()}, 1)

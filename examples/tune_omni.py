"""Tuning against tuning by hand: paper B's robot, noise from one lap, scored on other laps.

The hand-tuned values are those of the scenarios ``omni-circle`` and ``omni-square``; the search
begins at a rough guess that knows nothing of them, and is told of one lap only.
"""

import argparse
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

import kedge
from kedge.config.scenarios import load_scenario
from kedge.core.manifolds import space
from kedge.estimation.batch import pass_over
from kedge.estimation.rig import as_arrays
from kedge.simulation.simulate import schedule, simulate, with_readings
from kedge.tuning.evaluator import Case
from kedge.tuning.tunable import choose, placed
from kedge.tuning.tuning import Search, Tuned, tune

GUESS = {
    "wheel_noise": 0.1,
    "slip_noise": 0.1,
    "turn_noise": 0.1,
    "offset_std": 0.3,
    "orientation_std": 0.3,
}


def guessed(rig: kedge.Rig) -> kedge.Rig:
    """The rig as somebody would begin who has not tuned it."""
    chosen = choose(rig, list(GUESS))
    return placed(as_arrays(rig), chosen, jnp.asarray(list(GUESS.values())))


def lap_for_tuning(scenario: kedge.Scenario, seed: int, with_truth: bool) -> Tuned:
    """What one lap says of the noise."""
    recording, truth = kedge.record(scenario, jr.fold_in(jr.key(1), seed))
    rig = guessed(scenario.rig)
    given = truth if with_truth else None
    filter = kedge.make_filter("extended")
    return tune(
        filter, [Case(rig, recording, given)], choose(rig, list(GUESS)), Search(starts=2)
    )


def score(scenario: kedge.Scenario, rigs: Sequence[kedge.Rig], runs: int) -> np.ndarray:
    """Position RMSE (m), heading RMSE (rad), NEES and NIS of rigs over the same other laps."""
    plan = schedule(scenario)
    fixes = np.flatnonzero(np.asarray(plan.log.schedule.sensor) == 0)
    step = np.round(np.asarray(plan.log.schedule.time)[fixes] / scenario.dt).astype(int) - 1
    filter = as_arrays(kedge.make_filter("extended"))

    @eqx.filter_jit
    def run(rig, keys):
        def one(key):
            sim_key, near_key = jr.split(key)
            lap = simulate(scenario, sim_key)
            states = space(lap.start)
            near = jnp.sqrt(jnp.diag(rig.prior.cov)) * jr.normal(near_key, (states.size,))
            prior = kedge.Gaussian(states.boxplus(lap.start, near), rig.prior.cov)
            own = eqx.tree_at(lambda r: r.prior, rig, prior)
            found = pass_over(filter, own, with_readings(plan.log, scenario, lap), key, False)[
                0
            ]
            believed = jax.tree.map(lambda leaf: leaf[fixes], found.moments.mean)
            true = jax.tree.map(lambda leaf: leaf[step], lap.truth)
            error = jax.vmap(states.boxminus)(true, believed)
            white = jnp.linalg.solve(found.moments.cov[fixes], error[..., None])[..., 0]
            nees = jnp.sum(error * white, axis=1)
            squares = jnp.sum(error[:, :2] ** 2, axis=1), error[:, 2] ** 2
            return jnp.stack([jnp.mean(x) for x in (*squares, nees, found.outcome.nis[fixes])])

        return jax.vmap(one)(keys)

    keys = jr.split(jr.key(2), runs)
    rows = []
    for rig in rigs:
        parts = [run(as_arrays(rig), part) for part in jnp.split(keys, max(runs // 20, 1))]
        mean = np.mean(np.concatenate(parts), axis=0)
        rows.append([*np.sqrt(mean[:2]), *mean[2:]])
    return np.array(rows)


def compare(name: str, seed: int, runs: int) -> tuple[dict[str, Tuned], np.ndarray]:
    """Tune on one lap with and without truth; scores of hand, guess, and the two tuned."""
    scenario = load_scenario(name).scenario
    tuned = {
        "innovations": lap_for_tuning(scenario, seed, False),
        "truth": lap_for_tuning(scenario, seed, True),
    }
    rigs = [scenario.rig, guessed(scenario.rig)]
    rigs += [t.rig(as_arrays(scenario.rig)) for t in tuned.values()]
    return tuned, score(scenario, rigs, runs)


def main() -> None:
    """Compute and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200, help="Laps to score on.")
    parser.add_argument("--laps", type=int, default=3, help="Laps to tune on, one at a time.")
    options = parser.parse_args()
    for name in ("omni-circle", "omni-square"):
        print(
            f"{name}, {options.runs} other laps     position m  heading rad  NEES   NIS (of 3)"
        )
        for seed in range(options.laps):
            tuned, scores = compare(name, seed, options.runs)
            cases = ["by hand", "guess", *(f"lap {seed}, by {what}" for what in tuned)]
            for case, row in zip(cases, scores, strict=True):
                if seed == 0 or "lap" in case:
                    place, turn, nees, nis = row
                    print(f"  {case:28s} {place:12.4f} {turn:12.4f} {nees:6.2f} {nis:6.2f}")
            for what, found in tuned.items():
                said = [
                    f"{t.key.split('.')[-1]} {value:.3g} ({j.verdict.split(':')[0]})"
                    for t, value, j in zip(
                        found.chosen, found.values, found.judgements, strict=True
                    )
                ]
                print(f"    {what}: {', '.join(said)}", flush=True)


if __name__ == "__main__":
    main()

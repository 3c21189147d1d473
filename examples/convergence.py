"""How fast ensemble and particle filters approach the exact posterior as their number grows.

    python examples/convergence.py [--out docs/why/convergence] [--runs 64] [--largest 3000]

Draws two figures as SVG and prints the numbers in them: a linear problem against the Kalman
filter, and a nonlinear one with two-humped posteriors against integration on a grid.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

import kedge
from kedge.core.quantities import Range
from kedge.reports.style import PALETTE, looks, save_png, styled, subplots, svg_of

COUNTS = (10, 30, 100, 300, 1000, 3000)
NAMES = ("ensemble", "etkf", "particle", "guided", "auxiliary")
LOGS = 8


class Growth(NamedTuple):
    place: Range


class GrowthVehicle(kedge.AbstractVehicle[Growth, Growth, Growth]):
    r"""$x' = x / 2 + 25 x / (1 + x^2) + u + w$, $u = 8 \cos 1.2 t$, $w \sim N(0, 10)$.

    Source: N. Gordon, D. Salmond, A. Smith, "Novel approach to nonlinear/non-Gaussian Bayesian
    state estimation", IEE Proc. F 140(2), 1993, section 5.1.
    """

    def step(self, state, control, noise, dt):
        x = state.place
        return Growth(x / 2 + 25 * x / (1 + x**2) + control.place + noise.place * dt)

    def noise_density(self):
        return Growth(jnp.sqrt(10.0))

    def start(self):
        return Growth(jnp.array(0.1))

    def nominal_control(self, time):
        return Growth(8 * jnp.cos(1.2 * time))


class Square(kedge.core.contracts.AbstractSensor[Growth]):
    """$z = x^2 / 20 + v$: it cannot tell left from right."""

    reads = Growth
    measures = Growth
    nominal_rate = 1.0

    def observe(self, state):
        return Growth(state.place**2 / 20)

    def noise_std(self, state):
        return Growth(jnp.array(1.0))


def linear() -> kedge.Scenario:
    """A point of constant velocity, seen by GNSS once a second."""
    vehicle = kedge.make_vehicle("constant-velocity", acceleration_noise=1.0)
    gnss = kedge.Installation("gnss", kedge.make_sensor("gnss", std=1.0), rate=1.0)
    prior = kedge.Gaussian(vehicle.start(), jnp.diag(jnp.array([1.0, 1.0, 0.3, 0.3])))
    return kedge.Scenario(kedge.Rig(vehicle, (gnss,), prior), duration=10.0, dt=1.0)


def nonlinear() -> kedge.Scenario:
    """The growth model, one reading a step."""
    vehicle = GrowthVehicle()
    prior = kedge.Gaussian(vehicle.start(), jnp.array([[2.0]]))
    square = kedge.Installation("square", Square())
    return kedge.Scenario(kedge.Rig(vehicle, (square,), prior), duration=20.0, dt=1.0)


def recorded(scenario: kedge.Scenario) -> kedge.Log:
    """Several logs of a scenario; controls and readings have a leading axis."""
    keys = jax.random.split(jax.random.key(1), LOGS)
    logs = [kedge.record(scenario, key, output_rate=1e-3)[0].log for key in keys]
    many = [log._replace(schedule=None) for log in logs]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *many)
    return stacked._replace(schedule=logs[0].schedule)


def means_of(name: str, scenario: kedge.Scenario, logs: kedge.Log, runs: int, **parameters):
    """Posterior means of each log, run and event, as tangent coordinates; and covariances."""
    filter = kedge.make_filter(name, **parameters)

    @jax.jit
    def estimate(keys):
        def one(controls, readings, key):
            log = kedge.Log(logs.schedule, controls, readings)
            return kedge.estimate(filter, scenario.rig, log, key).moments

        by_run = jax.vmap(one, (None, None, 0))
        return jax.vmap(by_run, (0, 0, None))(logs.controls, logs.readings, keys)

    moments = estimate(jax.random.split(jax.random.key(2), runs))
    flat = [np.asarray(leaf).reshape(*moments.cov.shape[:-2], -1) for leaf in moments.mean]
    return np.concatenate(flat, axis=-1), np.asarray(moments.cov)


def on_a_grid(logs: kedge.Log) -> tuple[np.ndarray, np.ndarray]:
    """Exact posterior means and variances of the growth model, by sums over a fine grid."""
    grid = np.linspace(-45, 45, 3001)
    control, seen = (
        np.asarray(logs.controls.place),
        np.asarray(logs.readings[0].measurement.place),
    )
    time, _, row = (np.asarray(part) for part in logs.schedule)
    sensor = np.asarray(logs.schedule.sensor)
    drift = grid / 2 + 25 * grid / (1 + grid**2)
    means, variances = np.zeros(control.shape), np.zeros(control.shape)
    for k in range(len(control)):
        weight, last = scipy.stats.norm(0.1, np.sqrt(2)).pdf(grid), 0.0
        for i, at in enumerate(time):
            if at > last:
                gap = grid[:, None] - (drift + control[k, i])[None]
                weight = np.exp(-(gap**2) / 20) @ weight
            if sensor[i] >= 0:
                weight = weight * np.exp(-((seen[k, row[i]] - grid**2 / 20) ** 2) / 2)
            weight, last = weight / weight.sum(), at
            means[k, i] = weight @ grid
            variances[k, i] = weight @ (grid - means[k, i]) ** 2
    return means[..., None], variances[..., None, None]


def distance(means: np.ndarray, exact: np.ndarray, cov: np.ndarray) -> float:
    """RMS distance from the exact mean, in standard deviations of the exact posterior."""
    error = means - exact[:, None]
    white = np.linalg.solve(np.linalg.cholesky(cov)[:, None], error[..., None])
    return float(np.sqrt(np.mean(white**2)))


@styled
def draw(title: str, found: dict[str, dict[int, float]], others: dict[str, float]):
    """RMS distance against the number, with the line of independent samples."""
    ax = subplots(height=3.6)[0, 0]
    styles = looks(list(found))
    for name, points in found.items():
        style = styles[name]
        ax.loglog(
            list(points),
            list(points.values()),
            marker="o",
            markersize=3.5,
            color=style.color,
            linestyle=style.dash,
            label=name,
        )
    ends = np.array([COUNTS[0], max(max(points) for points in found.values())])
    muted = PALETTE["muted"][0]
    ax.loglog(ends, ends**-0.5, color=muted, linestyle=":", label="slope −1/2: 1/√N")
    for (name, value), dash in zip(others.items(), ((0, (5, 1.2)), "-."), strict=False):
        ax.axhline(value, color=muted, linestyle=dash, label=name)
    ax.set_xlabel("members or particles N")
    ax.set_ylabel("RMS distance from the exact mean\n(posterior standard deviations)")
    ax.set_title(title)
    ax.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return ax.figure


def main() -> None:
    """Compute, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/why/convergence"))
    parser.add_argument("--runs", type=int, default=64)
    parser.add_argument("--largest", type=int, default=3000)
    parser.add_argument("--png", action="store_true", help="PNG beside the SVG")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for label, title, scenario in (
        ("linear", "Linear, Gaussian: against the Kalman filter", linear()),
        ("nonlinear", "Growth model: against integration on a grid", nonlinear()),
    ):
        logs, others = recorded(scenario), {}
        if label == "linear":
            mean, cov = means_of("kalman", scenario, logs, 1)
            mean, cov = mean[:, 0], cov[:, 0]
        else:
            mean, cov = on_a_grid(logs)
            for name in ("extended", "unscented"):
                others[name] = distance(means_of(name, scenario, logs, 1)[0], mean, cov)
        found = {}
        for name in NAMES:
            found[name] = {
                count: distance(
                    means_of(name, scenario, logs, options.runs, count=count)[0], mean, cov
                )
                for count in COUNTS
                if count <= options.largest
            }
            counts, values = map(np.array, zip(*found[name].items(), strict=True))
            upper = counts >= 100
            slope = np.polyfit(np.log(counts[upper]), np.log(values[upper]), 1)[0]
            row = " ".join(f"{value:8.4f}" for value in values)
            print(
                f"{label:10s} {name:10s} {row}   slope from N = 100: {slope:+.2f}", flush=True
            )
        for name, value in others.items():
            print(f"{label:10s} {name:10s} {value:8.4f}")
        figure = draw(title, found, others)
        (options.out / f"{label}.svg").write_text(svg_of(figure))
        if options.png:
            save_png(figure, options.out / f"{label}.png")


if __name__ == "__main__":
    main()

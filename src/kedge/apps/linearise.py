"""The work behind ``kedge linearise``: a rig as a linear system, as table, JSON and .mat."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.io import savemat

from kedge.apps.console import console_progress, print_table
from kedge.apps.workflow import load, settings
from kedge.config.filters import build_filter
from kedge.config.loading import load_rig
from kedge.config.rigs import shipped
from kedge.config.scenarios import load_scenario
from kedge.core.errors import ConfigError
from kedge.core.manifolds import space
from kedge.estimation.batch import estimate
from kedge.estimation.linearisation import Discretised, LinearSystem, linearise, matrices
from kedge.estimation.rig import Rig
from kedge.formats.results_folder import results_folder

FORM = "{:.6g}"


class Linearised:
    """A system, what it is discretised over, and A, B along a log if there is one."""

    def __init__(self, rig: Rig, system: LinearSystem, dt: float, along: dict[str, Any]):
        self.rig, self.system, self.dt, self.along = rig, system, dt, along
        self.discrete: Discretised = system.discretised(dt)

    def record(self) -> dict[str, Any]:
        """All of it but the matrices along a log, as JSON has it."""
        system, values = self.system, self.system.eigenvalues()
        return {
            **{name: list(getattr(system, name)) for name in ("states", "inputs", "outputs")},
            **{name: getattr(system, name).tolist() for name in "ABCDQR"},
            "dt": self.dt,
            **{f"{name}d": getattr(self.discrete, name).tolist() for name in "FGQ"},
            "eigenvalues": [[float(v.real), float(v.imag)] for v in values],
            "observability": system.observability()._asdict(),
            "controllability": system.controllability()._asdict(),
        }

    def write(self, folder: Path) -> None:
        """``linear.mat``: the matrices, and A and B along the log."""
        record = self.record()
        labels = {n: np.array(record[n], object) for n in ("states", "inputs", "outputs")}
        names = [*"ABCDQR", "Fd", "Gd", "Qd"]
        savemat(
            folder / "linear.mat",
            {**{n: np.array(record[n]) for n in names}, **labels, "dt": self.dt, **self.along},
        )


def execute(
    name: str,
    log: str | None,
    at: Sequence[str],
    control: Sequence[str],
    dt: float,
    until: float | None,
    changes: Sequence[str] | None,
    out: Path | None,
) -> Linearised:
    """Linearise a rig or a scenario; write ``linear.mat`` if there is to be a folder.

    Raises:
        KedgeError: it cannot be read or linearised, or a component is unknown.
    """
    along: dict[str, Any] = {}
    if log is not None:
        problem = load(name, log, "none", until, changes)
        rig = problem.rig
        with console_progress() as progress:
            progress(f"{problem.filter}: the path to linearise about")
            along = _along(rig, problem)
    elif _is_scenario(name):
        rig = load_scenario(name, settings(changes)).scenario.rig
    else:
        rig = load_rig(name, settings(changes))
    state = _placed("--at", rig.prior.mean, at)
    driven = rig.vehicle.nominal_control(jnp.zeros(()))
    system = linearise(rig, state, _placed("--control", driven, control))
    result = Linearised(rig, system, dt, along)
    if out is not None:
        with results_folder(out, "linearise") as folder:
            result.write(folder)
    return result


def _is_scenario(name: str) -> bool:
    path = Path(name)
    if path.suffix == ".toml":
        return path.is_file() and "[scenario]" in path.read_text(errors="replace")
    return name in shipped("scenarios")


def _along(rig: Rig, problem: Any) -> dict[str, Any]:
    """A and B at the output times, about the estimate."""
    recording = problem.recording
    means = estimate(build_filter(problem.filter), rig, recording.log).moments.mean
    rows = recording.outputs
    states, controls = (
        jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], tree)
        for tree in (means, recording.log.controls)
    )
    A, B, _ = jax.vmap(lambda state, held: matrices(rig.vehicle, state, held))(states, controls)
    time = np.asarray(recording.log.schedule.time)[rows]
    return {"time": time, "A_along": np.asarray(A), "B_along": np.asarray(B)}


def _placed(option: str, base: Any, changes: Sequence[str]) -> Any:
    """A state or control with components set: ``heading=0.5``.

    Raises:
        ConfigError: there is no such component, or it is no number.
    """
    manifold = space(base)
    delta = np.zeros(manifold.size)
    for change in changes:
        label, _, text = change.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if label not in manifold.labels or not np.isfinite(value):
            raise ConfigError(
                f"{option} {change}: expected COMPONENT=NUMBER, of {', '.join(manifold.labels)}"
            )
        place = manifold.labels.index(label)
        zero = manifold.boxminus(base, jax.tree.map(jnp.zeros_like, base))
        if not np.isfinite(np.asarray(zero)).all():
            raise ConfigError(f"{option} {change}: an attitude cannot be set by a component")
        delta[place] = value - float(zero[place])
    return manifold.boxplus(base, jnp.asarray(delta)) if changes else base


def print_linearised(result: Linearised) -> None:
    """The matrices as tables, then eigenvalues and ranks."""
    system, discrete = result.system, result.discrete
    states, inputs, outputs = system.states, system.inputs, system.outputs
    for title, matrix, rows, columns in (
        ("A", system.A, states, states),
        ("B", system.B, states, inputs),
        ("C", system.C, outputs, states),
        ("Q", system.Q, states, states),
        ("R", system.R, outputs, outputs),
        (f"F over {result.dt:g} s", discrete.F, states, states),
        (f"G over {result.dt:g} s", discrete.G, states, inputs),
        (f"Q over {result.dt:g} s", discrete.Q, states, states),
    ):
        if matrix.size:
            cells = [
                [name, *map(FORM.format, row + 0.0)]  # 0, not -0
                for name, row in zip(rows, matrix, strict=True)
            ]
            print_table([title, *columns], cells)
            print()
    print("D is zero: sensors read the state alone.\n")
    values = system.eigenvalues()
    print("eigenvalues of A (1/s): " + ", ".join(f"{v:.4g}" for v in values))
    for word, rank in (
        ("observability", system.observability()),
        ("controllability", system.controllability()),
    ):
        beside = f"; not reached: {', '.join(rank.missing)}" if rank.missing else ""
        print(f"{word}: rank {rank.rank} of {len(states)}{beside}")

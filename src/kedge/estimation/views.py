"""Estimates as a table, as a drawing and in a notebook: needs the extra "studio"."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from kedge.core.errors import ContractError, KedgeError
from kedge.core.manifolds import Space, space
from kedge.core.verdicts import Verdict

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingTypeStubs]

BOUND = 1.959963984540054
"""Standard deviations within which 95 % of a normal distribution lie."""


def table(estimates: Any) -> "pandas.DataFrame":
    """A row for each event, with the time in s as its index.

    Columns: the components of the mean, as files name them, in SI units and radians; the
    standard deviation of each component, ``position_x_std``; the verdict on the event's
    reading, its NIS with degrees of freedom, and its log-likelihood.

    Raises:
        ContractError: the estimates are of many runs.
        KedgeError: pandas is not installed.
    """
    pandas = pandas_module()
    states, means, stds = _arrays(estimates)
    outcome = estimates.outcome
    columns: dict[str, Any] = {}
    for name, leaf in means.items():
        rows = leaf.reshape(len(leaf), -1)
        columns |= dict(zip(states.columns[name], rows.T, strict=True))
    columns |= {f"{label}_std": std for label, std in zip(states.labels, stds.T, strict=True)}
    names = [Verdict(value).name.lower() for value in np.asarray(outcome.verdict).tolist()]
    columns["verdict"] = pandas.Categorical(names, [v.name.lower() for v in Verdict])
    columns |= {name: np.asarray(getattr(outcome, name)) for name in ("nis", "dof")}
    columns["log_likelihood"] = np.asarray(outcome.log_likelihood)
    return pandas.DataFrame(columns, pandas.Index(np.asarray(estimates.time), name="time"))


def plot(estimates: Any, ax: Any = None, field: str = "") -> Any:
    """Draw a field into ``ax``, and return the axes.

    Without a ``field`` it is the track of the position in the plane, or the first field where
    there is none; any other field is drawn over time, with the 95 % bounds of each component.

    Raises:
        ContractError: the state has no such field, or the estimates are of many runs.
        KedgeError: there is no ``ax``, and matplotlib is not installed.
    """
    states, means, stds = _arrays(estimates)
    if field and field not in means:
        raise ContractError(f"plot: no field {field!r}; there are {', '.join(means)}")
    if ax is None:
        ax = _new_axes()
    track = means.get("position")
    if not field and track is not None and track.ndim == 2 and track.shape[1] in (2, 3):
        ax.plot(track[:, 0], track[:, 1], label="estimate")
        ax.set(xlabel="position_x (m)", ylabel="position_y (m)")
        ax.set_aspect("equal", adjustable="datalim")
        return ax
    field = field or next(iter(means))
    time, chart = (
        np.asarray(estimates.time),
        dict(zip(means, states.charts, strict=True))[field],
    )
    rows, names = means[field].reshape(len(time), -1), states.columns[field]
    bounds = BOUND * stds[:, states.slices()[field]]
    flat = chart.shape == chart.tangent_shape  # the spread of a quaternion is that of a turn
    for index, name in enumerate(names):
        (line,) = ax.plot(time, rows[:, index], label=name)
        if flat:
            low, high = rows[:, index] - bounds[:, index], rows[:, index] + bounds[:, index]
            ax.fill_between(time, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
    ax.set(xlabel="time (s)", ylabel=f"{field} ({chart.unit if flat else '1'})")
    if len(names) > 1:
        ax.legend()
    return ax


def summary(estimates: Any) -> str:
    """What a notebook shows: span, readings by verdict, log-likelihood, the last state."""
    if np.ndim(estimates.time) != 1 or np.ndim(estimates.outcome.verdict) != 1:
        return f"<p>Estimates of {np.shape(estimates.outcome.verdict)} runs and events</p>"
    states, means, stds = _arrays(estimates)
    time, verdicts = np.asarray(estimates.time), np.asarray(estimates.outcome.verdict)
    counts = {v: int((verdicts == v).sum()) for v in Verdict if v != Verdict.NONE}
    shown = [f"{v.name.lower()} {n}" for v, n in counts.items() if n]
    facts = {
        "events": f"{len(time)}, from {time[0]:g} s to {time[-1]:g} s",
        "readings": ", ".join(shown) or "none",
        "log-likelihood": f"{float(estimates.log_likelihood):.6g}",
    }
    for name, cut in states.slices().items():
        value = np.array2string(means[name][-1], precision=4, separator=", ")
        spread = np.array2string(stds[-1, cut], precision=3, separator=", ")
        facts[f"last {name}"] = f"{value} &plusmn; {spread}"
    rows = "".join(f"<tr><th>{name}</th><td>{text}</td></tr>" for name, text in facts.items())
    return f"<table>{rows}</table>"


def _arrays(
    estimates: Any,
) -> tuple[Space, dict[str, np.ndarray], Float[np.ndarray, "T n"]]:
    """The space of the states, their means by field, their standard deviations."""
    if np.ndim(estimates.outcome.verdict) != 1:
        shape = np.shape(estimates.outcome.verdict)
        raise ContractError(
            f"these are estimates of many runs, of shape {shape}: take one of them first, "
            "jax.tree.map(lambda leaf: leaf[0], estimates)"
        )
    mean, cov = estimates.moments.mean, np.asarray(estimates.moments.cov)
    means = {name: np.asarray(leaf) for name, leaf in mean._asdict().items()}
    variances = np.diagonal(cov, axis1=-2, axis2=-1)
    return space(mean), means, np.sqrt(np.maximum(variances, 0.0))


def pandas_module() -> Any:
    """The module, which comes with the extra "studio".

    Raises:
        KedgeError: it is not installed.
    """
    try:
        import pandas  # pyright: ignore[reportMissingTypeStubs]
    except ImportError as error:
        why = "to_pandas() needs pandas: pip install 'kedge-nav[studio]'"
        raise KedgeError(why) from error
    return pandas


def _new_axes() -> Any:
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise KedgeError("plot() needs matplotlib: pip install 'kedge-nav[studio]'") from error
    return pyplot.subplots()[1]

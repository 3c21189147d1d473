"""What ``kedge tune`` prints."""

from collections.abc import Mapping
from typing import Any

from kedge.apps.console import printer


def print_tuned(summary: Mapping[str, Any]) -> None:
    """The table of numbers, what the log says of them, and the scores before and after."""
    from rich.table import Table

    console = printer()
    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in ("parameter", "start", "found", "factor", "std error", "identified"):
        table.add_column(
            name, justify="left" if name in ("parameter", "identified") else "right"
        )
    for row in summary["parameters"]:
        factor = row["factor"]
        table.add_row(
            row["key"], f"{row['start']:.4g}", f"{row['found']:.4g}",
            "-" if factor is None else f"{factor:.3g}", _uncertainty(row), row["verdict"],
        )  # fmt: skip
    console.print(table)
    for sentence in summary["flat"]:
        console.print(f"flat: {sentence}", markup=False, soft_wrap=True)
    loss = summary["loss"]
    judged = {"truth": "output time", "horizons": "reading and horizon"}
    console.print(
        f"loss by {judged.get(summary['criterion'], 'reading')}: "
        f"{loss['start']:.4g} -> {loss['tuned']:.4g}; {summary['agreed']} of "
        f"{len(summary['starts'])} starts agree\n"
    )
    for part in summary["scores"]["start"]:
        several = {name: parts[part] for name, parts in summary["scores"].items()}
        said = ", ".join(_said(several))
        names = " -> ".join(several).replace("_", " ")
        console.print(f"{part.replace('_', '-')} part ({names}): {said}", soft_wrap=True)
    if (verdict := summary.get("generalisation")) is not None:
        for name, log in summary["logs"].items():
            console.print(f"{name.replace('_', '-')}: {log}", markup=False, soft_wrap=True)
        console.print(verdict["sentence"], markup=False, soft_wrap=True)


def _uncertainty(row: Mapping[str, Any]) -> str:
    error = row["std_error"]
    if error is None or error > 10:
        return "-"
    return f"{100 * error:.2g} %" if row["of_logarithm"] else f"{error:.2g}"


def _said(several: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Each score as it was and as it is."""
    first = next(iter(several.values()))
    rows: list[tuple[str, tuple[str, ...]]]
    rows = [("loss", ("loss",))] if "loss" in first else []
    rows += [(f"rmse {field}", ("rmse", field)) for field in first.get("rmse", {})]
    rows += [(f"in 95 % {f}", ("coverage_95", f)) for f in first.get("coverage_95", {})]
    for name in ("nees", "nis"):
        if f"{name}_dof" in first:
            rows.append((f"{name} (of {first[f'{name}_dof']:.3g})", (name,)))
    found = []
    for title, path in [*rows, ("fused", ("fused",))]:
        values = []
        for scores in several.values():
            value: Any = scores
            for key in path:
                value = value.get(key, {})
            values.append(f"{value:.3g}" if isinstance(value, float) else f"{value or '-'}")
        found.append(f"{title} {' -> '.join(values)}")
    return found

"""The report of a study: its scores, figures, claims and where they come from, as one page."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from kedge.core.manifolds import Space, space_of
from kedge.reports import study_figures as figures
from kedge.reports import study_findings as findings
from kedge.reports import study_tables as tables
from kedge.reports import style
from kedge.reports.maps import strays, target_map
from kedge.reports.page import Front, Plate, write_page
from kedge.reports.study_cost import plot_cost
from kedge.reports.study_curves import nis_curve
from kedge.reports.study_lines import featured, series, study_looks
from kedge.reports.study_tracks import (
    Seen,
    Track,
    plot_component,
    plot_panels,
    plot_plan,
    plot_profile,
    shown_span,
)
from kedge.studies.figures_of_merit import StudySummary
from kedge.studies.scores import Result
from kedge.studies.study import Study
from kedge.studies.summary import curves


class StudyContent(NamedTuple):
    """All that a study's report is made of."""

    study: Study
    results: Mapping[str, Result]
    truth: Mapping[str, np.ndarray]
    """The first run's, by field, at the scored times."""
    readings: Mapping[str, np.ndarray]
    """The first run's readings of fields of the state, by ``sensor.field``."""
    summary: StudySummary
    configuration: str
    """The resolved scenario, as text."""
    facts: Mapping[str, str]
    """Versions, seed, digest, command."""
    featured: Sequence[str] = ()
    """The filters whose tracks are shown, if the scenario names any."""
    panels: Sequence[str] = ()
    """The filters whose first run is drawn by itself."""


def write_study_report(folder: Path, content: StudyContent) -> Path:
    """Write ``report.html`` and its figures; return the page's path.

    The same content gives the same bytes.

    Raises:
        KedgeError: matplotlib or jinja2 is not installed.
    """
    summary, states = content.summary, _states(content)
    filters = summary.filters
    front = Front(
        kicker="kedge · study",
        title=summary.about.title,
        headline=findings.headline(summary, states),
        strip=findings.facts(summary, content.study),
        warnings=findings.warnings(summary),
    )
    burn_in = content.study.burn_in
    return write_page(
        folder,
        "study.html.j2",
        front,
        study_plates(content),
        summary=summary,
        looks=study_looks(list(filters)),
        filters=tables.merit_table(filters, states),
        all_steps=tables.merit_table(filters, states, False) if burn_in else None,
        burn_in=f"{burn_in:g}\u00a0s",
        windows=tables.window_tables(filters, states),
        published=tables.published_table(filters, *_unit(content)),
        expected=tables.band_table(summary.expected),
        marks=tables.MARKS,
        facts=content.facts,
        configuration=content.configuration,
    )


def study_plates(content: StudyContent) -> Iterator[Plate]:
    """The figures that this study has something to show in, drawn one by one."""
    yield from _scores(content)
    yield from _tracking(content)
    yield from _tracks(content)
    yield from _over_time(content)
    filters = content.summary.filters
    if series(list(filters)):
        first = next(iter(filters.values()))
        base, of = first.baseline, style.words(first.score_of)
        axes = figures.plot_members(filters, base, of)
        caption = (
            f"Errors of filters that differ in their number of members, relative to {base} "
            "over the same runs, with 95\u00a0% intervals (bootstrap over runs, in pairs)."
        )
        yield Plate("members", "members", caption, axes.figure)


def _scores(content: StudyContent) -> Iterator[Plate]:
    filters = content.summary.filters
    factor, unit = _unit(content)
    of = content.summary.score.of
    what = "time mean of the rms error" if of == "time-mean-rms" else f"{style.words(of)} RMSE"
    label = f"{what} ({unit or '–'})"
    axes = figures.plot_scores(filters, label, factor)
    caption = "Every filter's score over the same runs"
    caption += f", after the first {content.study.burn_in:g}\u00a0s" * bool(
        content.study.burn_in
    )
    if any(row.published for row in filters.values()):
        caption += "; diamonds: as published, by the sources below"
    yield Plate("scores", "scores", f"{caption}.", axes.figure)
    if sum(row.score.value > 0 and row.seconds_per_run > 0 for row in filters.values()) > 1:
        caption = (
            "Accuracy against cost: every filter's score and its time for one run. Full dots, "
            "joined: no other filter is both more accurate and faster."
        )
        yield Plate("cost", "scores", caption, plot_cost(filters, label, factor).figure)


def _tracking(content: StudyContent) -> Iterator[Plate]:
    """How well each filter's loop kept to the route, if the world says."""
    filters, states = content.summary.filters, _states(content)
    units = dict(zip(states.slices(), (states.units[c.start] for c in states.slices().values()),
                     strict=True))  # fmt: skip
    names = next(iter(filters.values())).settled.tracking
    if not names or not content.study.scenario.each_in_its_loop:
        return
    shown = {name: style.shown(units[name]) if name in units else (1.0, "") for name in names}
    axes = figures.plot_tracking(filters, shown)
    caption = (
        "Closed loops: how far from its route the vehicle was when the guidance believed each "
        "filter, with 95\u00a0% intervals over the same disturbances and noise."
    )
    yield Plate("tracking", "scores", caption, axes[0].figure)


def tracks(content: StudyContent, wanted: Sequence[str] = ()) -> list[Track]:
    """The first run by field, with the filters that stand for the others, or those wanted."""
    plan, states, listed = content.study.plan, _states(content), []
    examples = {name: result.example for name, result in content.results.items()}
    whole = {
        name: np.concatenate([np.ravel(values) for values in example.values()])
        for name, example in examples.items()
        if example
    }
    if not whole or not content.truth:
        return []
    names = featured(whole, wanted or content.featured)
    loops = content.study.scenario.each_in_its_loop
    for (field, cut), chart in zip(states.slices().items(), states.charts, strict=True):
        if chart.shape != chart.tangent_shape or field not in content.truth:
            continue
        size = cut.stop - cut.start

        def columns(values: Any, size: int = size) -> np.ndarray:
            return np.asarray(values).reshape(-1, size)

        seen = []
        for number, installation in enumerate(content.study.scenario.rig.sensors):
            values = content.readings.get(f"{installation.name}.{field}")
            if values is not None:
                time = plan.sensed_time[plan.sensor == number]
                seen.append(Seen(installation.name, time, columns(values)))
        track = Track(
            field,
            states.units[cut.start],
            plan.time,
            columns(content.truth[field]),
            {name: columns(examples[name][field]) for name in names},
            seen,
            {name: columns(content.results[name].track[field]) for name in names if loops},
            _route(content, plan.time) if field == "position" else None,
        )
        listed.append(track)
    return listed


def _tracks(content: StudyContent) -> Iterator[Plate]:
    listed, states = tracks(content), _states(content)
    where = next((track for track in listed if track.name == "position"), None)
    names = ", ".join(listed[0].estimates) if listed else ""
    if where is not None:
        targets = target_map(content.study.scenario.rig, {})
        axes = plot_plan(where, targets)
        caption = f"The first run in plan, to scale; estimates of {names}."
        if where.driven:
            caption = (
                "The first run in plan, to scale: where the vehicle went when the guidance "
                f"believed each filter ({names}); same disturbances, same noise."
            )
        if any(strays(path, axes) for path in (where.driven or where.estimates).values()):
            caption += " What strays beyond the view is cut off."
        yield Plate("map", "track", caption, axes.figure)
        if where.truth.shape[1] == 3 and np.ptp(where.truth[:, 2]) > 0:
            caption = "The first run from the side: height over the way covered in plan."
            yield Plate("profile", "track", caption, plot_profile(where).figure)
    yield from _panels(content)
    shown = 0
    first = content.summary.score.of
    ordered = sorted(listed, key=lambda track: (track.name != first, not track.seen))
    for track in [where] if where is not None else ordered:
        cut, part = states.slices()[track.name], shown_span(track)
        for index in range(min(cut.stop - cut.start, 3)):
            label = style.words(states.labels[cut.start + index])
            axes = plot_component(part, index, label)
            what = "in the first run" if part is track else "at the end of the first run"
            shows = f"true {label} in each filter's own loop," if part.driven else f"{label}"
            off = (
                "estimates are"
                if part.driven or not part.seen
                else "readings and estimates are"
            )
            caption = f"Above: {shows} {what}. Below: how far {off} off."
            name = f"{track.name}-{'xyz'[index]}" if cut.stop - cut.start > 1 else track.name
            yield Plate(name, "track", caption, axes[0].figure, shown >= 2)
            shown += 1


def _panels(content: StudyContent) -> Iterator[Plate]:
    """Each filter that the scenario names for it, by itself."""
    for track in tracks(content, content.panels) if content.panels else ():
        if track.name != "position" or track.driven:
            continue
        for name in track.estimates:
            if name in content.panels:
                caption = f"The first run of {name}: x and y over time, and in plan, to scale."
                file = "panels-" + re.sub(r"\W+", "-", name)
                yield Plate(file, "track", caption, plot_panels(track, name)[0].figure)


def _over_time(content: StudyContent) -> Iterator[Plate]:
    study, states = content.study, _states(content)
    curves_by_name = {
        n: curves(study, r) for n, r in content.results.items() if r.sums.total > 0
    }
    if not curves_by_name:
        return
    runs = style.count(content.summary.about.runs)
    each = study.score == "time-mean-rms"
    axes = figures.plot_error(curves_by_name, states, each)
    yield Plate(
        "error-over-time",
        "errors",
        f"Root mean square error over {runs} runs at each time. Filters whose curves agree to "
        "one part in a million are drawn as one.",
        axes[0, 0].figure,
    )
    if any(np.isfinite(c.nees).any() for c in curves_by_name.values()):
        axes = figures.plot_study_nees(curves_by_name, states.size)
        caption = (
            f"Normalised estimation error squared, mean over {runs} runs: inside the bounds "
            "(of a single time) 95\u00a0% of the time if the filter knows how good it is, "
            "above if it is over-confident."
        )
        yield Plate("nees", "consistency", caption, axes[0, 0].figure)
    sensors = study.scenario.rig.sensors
    judged = {
        name: [
            nis_curve(study.plan, content.results[name].sums, i) for i in range(len(sensors))
        ]
        for name in curves_by_name
    }
    judged = {n: cs for n, cs in judged.items() if any(len(c.nis) for c in cs)}
    if judged:
        axes = figures.plot_study_nis(judged, [sensor.name for sensor in sensors])
        caption = (
            f"Normalised innovation squared by component, mean over {runs} runs and "
            "neighbouring readings: 1 if the model is right. Where it peaks, the vehicle does "
            "what its model does not expect."
        )
        yield Plate("nis", "consistency", caption, axes[0, 0].figure)


def _route(content: StudyContent, time: np.ndarray) -> np.ndarray | None:
    """Where the vehicle was to be, if its world has a route in the plane."""
    route: Any = getattr(content.study.scenario.world, "route", None)
    if not hasattr(route, "at"):
        return None
    return np.asarray(jax.vmap(lambda at: route.at(at).position)(time))


def _unit(content: StudyContent) -> tuple[float, str]:
    factor, unit = findings.unit_of(content.summary, _states(content))
    return factor, "" if unit == "–" else unit


def _states(content: StudyContent) -> Space:
    return space_of(type(content.study.scenario.rig.prior.mean))

"""A simulated run as a log like any other: what is written can be read back and estimated."""

from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float, Int64, PRNGKeyArray

from kedge.core.manifolds import charts_of, columns_of, space_of
from kedge.estimation.log import SECOND
from kedge.formats.logs import RawLog, TargetMap
from kedge.formats.tables import Table
from kedge.simulation.scenario import Scenario
from kedge.simulation.simulate import simulate


def simulated_log(scenario: Scenario, key: PRNGKeyArray, title: str) -> RawLog:
    """One run of a scenario: controls as ``control``, a source a sensor, ``truth``, maps.

    A sensor's map is called like the sensor; its targets are numbered from 1.
    """
    run, rig = simulate(scenario, key), scenario.rig
    begins = _stamps(np.arange(scenario.steps) * scenario.dt)
    ends = _stamps(np.arange(1, scenario.steps + 1) * scenario.dt)
    tables, maps = {}, {}
    if run.controls:
        tables["control"] = _table("control", begins, run.controls)
    for installation, readings in zip(rig.sensors, run.readings, strict=True):
        # A recording stamps late what happened earlier; the latency takes it back.
        stamps = ends[scenario.ticks(installation) - 1] + round(installation.latency * SECOND)
        texts = {}
        if installation.targets is not None:
            texts["target"] = [str(i + 1) for i in np.asarray(readings.target).tolist()]
            place = _columns(vars(installation.sensor)["target"])
            ids = tuple(str(i + 1) for i in range(installation.targets))
            maps[installation.name] = TargetMap(ids, *place)
        name = installation.name
        tables[name] = _table(name, stamps, readings.measurement)._replace(texts=texts)
    return RawLog(title, tables, _table("truth", ends, run.truth), maps)


def _stamps(seconds: Float[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    return np.round(seconds * SECOND).astype(np.int64)


def _table(name: str, stamps: Int64[np.ndarray, " n"], values: tuple) -> Table:
    columns, units = _columns(values)
    return Table(name, Path(name), stamps, columns, {}, np.arange(len(stamps)) + 2, units)


def _columns(values: tuple) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The fields of a state, control, measurement or map as columns, with their units."""
    columns = {}
    for (field, chart), leaf in zip(
        charts_of(type(values)).items(), jax.tree.map(np.asarray, values), strict=True
    ):
        flat = leaf.reshape(len(leaf), -1)
        columns |= {n: flat[:, i] for i, n in enumerate(columns_of(field, chart))}
    return columns, space_of(type(values)).column_units

"""Readings held back: predicted over a horizon and compared, but not used."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from kedge.core.contracts import AbstractFilter
from kedge.estimation.log import Log
from kedge.estimation.rig import Rig
from kedge.filters.wrappers.withholding import Withholding


def windows(
    time: Float[Array, " T"], horizon: Float[Array, ""], phase: Float[Array, ""]
) -> Bool[Array, " T"]:
    """Which events lie in every second window as long as the horizon (s).

    Phases 0 and 1 share the log between them, but for its first window, in which a belief has
    to be made out of the prior.
    """
    window = jnp.floor(time / horizon)
    return (jnp.mod(window, 2) == phase) & (window > 0)


def with_twins(filter: AbstractFilter, rig: Rig) -> tuple[AbstractFilter, Rig]:
    """A filter and a rig with a twin of each sensor, whose readings it judges and ignores."""
    twins = [dataclasses.replace(s, name=f"{s.name} (held back)") for s in rig.sensors]
    names = tuple(twin.name for twin in twins)
    return Withholding(filter, withheld=names), Rig(
        rig.vehicle, (*rig.sensors, *twins), rig.prior
    )


def held_back(log: Log, held: Bool[Array, " T"]) -> Log:
    """The log of a rig with twins, whose readings at these events go to the twins.

    A twin's readings are as many as the sensor's, and stand in the same rows.
    """
    sensor, count = log.schedule.sensor, len(log.readings)
    given = jnp.where(held & (sensor >= 0), sensor + count, sensor)
    schedule = log.schedule._replace(sensor=given)
    return log._replace(schedule=schedule, readings=(*log.readings, *log.readings))

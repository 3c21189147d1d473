"""What the page is told once: vehicles, sources, names of all that frames count."""

from typing import Any

import numpy as np

from kedge.core.manifolds import space, space_of
from kedge.live.engine import Tracked, rate_of
from kedge.live.faults import KINDS
from kedge.live.frame import VERDICTS
from kedge.live.simulated import STEP, Drive, Fleet
from kedge.live.status import ORDER

MARGIN = 5.0  # m around all that moves


def describe(fleet: Fleet) -> dict[str, Any]:
    """The fleet as the page needs it; strict JSON."""
    paths = np.concatenate([one.truth[:, :2] for one in fleet.drives])
    low, high = paths.min(0) - MARGIN, paths.max(0) + MARGIN
    vehicles = [
        _vehicle(number, *pair)
        for number, pair in enumerate(zip(fleet.drives, fleet.engine.vehicles, strict=True))
    ]
    return {
        "title": "Simulated fleet",
        "simulated": True,
        "rate": round(1 / STEP),
        "axes": [{"name": "x", "unit": "m"}, {"name": "y", "unit": "m"}],
        "filters": {"extended": {"role": "filter-1", "speaks": True}},
        "statuses": list(ORDER),
        "verdicts": VERDICTS,
        "site": {"bounds": [float(edge) for edge in (*low, *high)], "areas": []},
        "targets": [],
        "vehicles": vehicles,
        "faults": [
            {"name": name, "text": text, "seconds": seconds}
            for name, (text, seconds) in KINDS.items()
        ],
    }


def _vehicle(number: int, drive: Drive, vehicle: Tracked) -> dict[str, Any]:
    start = space(drive.member.rig.prior.mean)
    sources = []
    for row, (sensor, absolute) in enumerate(
        zip(drive.member.rig.sensors, vehicle.absolute, strict=True)
    ):
        measured, rate = space_of(sensor.sensor.measures), rate_of(sensor)
        sources.append({
            "name": sensor.name,
            "kind": type(sensor.sensor).__name__.lower(),
            "measures": _fields(measured),
            "sigma": [float(std) for std in drive.std[row, : measured.size]],
            "rate": rate,
            "silence": max(vehicle.limits.silence, 3 / rate),
            "absolute": absolute,
        })  # fmt: skip
    about = {
        "id": number,
        "name": drive.plan.name,
        "kind": drive.plan.kind,
        "shape": drive.plan.shape,
        "size": list(drive.plan.size),
        "fields": _fields(start),
        "sources": sources,
        "limits": {"lost": vehicle.limits.lost, "aligned": vehicle.limits.aligned},
        "shadows": [],
        "filter": "extended",
    }
    if "position_z" in start.labels:
        about["profile"] = {"field": "position_z", "down": False}
    return about


def _fields(of: Any) -> list[dict[str, str]]:
    return [{"name": n, "unit": u} for n, u in zip(of.labels, of.units, strict=True)]

"""A rig's tables as those of a scenario: what is about its log is left out."""

import copy
from typing import Any

Tree = dict[str, Any]
OF_LOGS = (
    "title", "format", "bag", "map_origin", "truth", "control", "standing", "filter", "output",
)  # fmt: skip
"""Tables and keys of a rig that a scenario has not."""
OF_READINGS = ("source", "columns", "target", "ignore_targets", "std", "covariance")
DURATION = 60.0
"""s that are simulated unless the scenario says."""


def simulated(rig: Tree, name: str) -> Tree:
    """What a scenario that extends a rig begins with: its vehicle, sensors, prior and filter.

    The vehicle drives as it does by itself, for no log tells its control, and the prior is
    about its own start, for no log tells the truth.
    """
    scenario = copy.deepcopy({key: rig[key] for key in rig if key not in OF_LOGS})
    for sensor in scenario.get("sensors", {}).values():
        for key in OF_READINGS:
            sensor.pop(key, None)
    for key in ("from_truth", "source"):
        scenario.get("prior", {}).pop(key, None)
    filter = rig.get("filter", {}).get("name", "extended")
    scenario["scenario"] = {
        "title": rig.get("title") or f"{name}, simulated",
        "source": f"the rig {name}",
        "duration": DURATION,
        "filters": list(dict.fromkeys(["dead-reckoning", filter])),
    }
    return scenario

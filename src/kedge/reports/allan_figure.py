"""The figure of Allan deviations: what a still sensor showed, and the noise fitted to it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kedge.calibration.allan import AllanCurve, AllanFit
from kedge.reports.style import styled


@styled
def draw_allan(
    curves: Mapping[str, AllanCurve], fitted: AllanFit, unit: str, ax: Any, name: str
) -> None:
    """Deviations by axis over their time, and what was fitted, on logarithmic axes."""
    for label, curve in curves.items():
        ax.loglog(curve.tau, curve.deviation, ".-", markersize=3, linewidth=0.8, label=label)
    tau = next(iter(curves.values())).tau
    ax.loglog(tau, np.sqrt(fitted.variance(tau)), "k--", linewidth=1.2, label="fitted")
    ax.set_xlabel("averaging time (s)")
    ax.set_ylabel(f"Allan deviation ({unit})")
    ax.set_title(name)
    ax.legend()

"""Modules that have another name than in the last version: their import says which.

The table is kept for one version after a move.
"""

import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

MOVED_TO = {
    "calibration": {
        "evaluation": "allan doppler_calibration=doppler",
        "files": "error_curves=error_curve_files",
        "positioning": (
            "calibration=anchors error_curves histogram obstacles placement power_bias survey"
        ),
    },
    "compiler": {
        "numerics.native": (
            "algebra calling elementwise emit functions graph indexing interpret "
            "kernel liveness machine program reducing shaping text values"
        ),
    },
    "config": {
        "files": (
            "building config=rigs fault_config filters inheritance models plugins "
            "problem readings scenarios standing"
        ),
    },
    "datasets": {
        "apps": "datasets=fetch",
        "files": "akit euroc hanyang labyrinth lias mrclam navego plaza starloc trek1000",
    },
    "filters.ensemble": {
        "filters": (
            "denkf enkf_n ensemble=stochastic ensembles=recursion etkf serial_enkf transform"
        ),
    },
    "filters.gaussian": {
        "filters": (
            "cubature dead_reckoning extended gauss_hermite gaussian=recursion "
            "iterated kalman posterior_linearisation relinearisation square_root "
            "unscented"
        ),
    },
    "filters.particle": {
        "filters": "auxiliary cloud guided particle=bootstrap redraw",
    },
    "filters.published": {
        "filters": "fuzzy fuzzy_noise linearised raw",
    },
    "filters.wrappers": {
        "filters": (
            "adaptive carried gate_or_student gated hypotheses interacting "
            "learned_noise robust wrapper"
        ),
    },
    "formats": {
        "files": (
            "atomic bag_config bag_messages bags inertial logs readers results "
            "simulated tables toml tum units"
        ),
    },
    "reports": {
        "evaluation": (
            "diagnostics drawing figures findings fixes page report spatial "
            "study_curves study_figures study_findings study_lines study_report "
            "study_tables study_tracks style tables tuning_report"
        ),
    },
    "simulation.worlds": {
        "simulation": (
            "auv_protocol auv_world=auv guided_point lane_keeping measured_point "
            "measured_vehicle omni_robot surveyed_points"
        ),
    },
    "studies": {
        "apps": "engines",
        "evaluation": (
            "study study_claims=claims study_measure=measure study_pass=measure "
            "study_scores=scores study_summary=summary"
        ),
        "files": "chunks",
    },
    "tuning": {
        "evaluation": (
            "curvature tunable tuning tuning_evaluator=evaluator tuning_log=log "
            "tuning_loss=loss"
        ),
    },
    "vehicles.benchmarks": {
        "vehicles": "autonomous lorenz63 lorenz96",
    },
    "vehicles.underwater": {
        "vehicles": (
            "accelerations coefficient_files hull_geometry hydrodynamics underwater "
            "underwater_level=level"
        ),
    },
}
"""New package -> old package -> modules, ``old=new`` where the name itself changed."""


def moved_modules() -> dict[str, str]:
    """Old module -> new module."""
    modules: dict[str, str] = {}
    for new, sources in MOVED_TO.items():
        for old, names in sources.items():
            for pair in names.split():
                before, _, after = pair.partition("=")
                modules[f"kedge.{old}.{before}"] = f"kedge.{new}.{after or before}"
    return modules


GONE = {
    "kedge.files": "kedge.formats, kedge.config and kedge.datasets",
    "kedge.numerics.native": "kedge.compiler",
}
"""Packages that are no more, and what took their place."""


class MovedFinder(MetaPathFinder, Loader):
    """The last finder that Python asks for a module: it knows where the modules have gone."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """None for all names but those that moved.

        Raises:
            ImportError: naming the new one.
        """
        if name in GONE:
            return ModuleSpec(name, self, is_package=True)
        new = moved_modules().get(name) if name.startswith("kedge.") else None
        if new is not None:
            raise ImportError(f"{name} is now {new}: import it from there", name=name)
        return None

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """The shell of a package that is no more: Python imports it before its modules."""
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Whatever is asked of it raises an ``AttributeError`` that names the new package."""
        name = module.__name__

        def missing(attribute: str) -> Any:
            new = moved_modules().get(f"{name}.{attribute}", GONE[name])
            raise AttributeError(f"{name}.{attribute}: {name} is no more; see {new}")

        module.__dict__["__getattr__"] = missing


def install() -> None:
    """Ask :class:`MovedFinder` after all other finders."""
    if not any(isinstance(finder, MovedFinder) for finder in sys.meta_path):
        sys.meta_path.append(MovedFinder())

from kedge.positioning.differences import difference_bound as difference_bound
from kedge.positioning.differences import differences as solve_differences
from kedge.positioning.epochs import Epochs as Epochs
from kedge.positioning.epochs import epochs_of as epochs_of
from kedge.positioning.fix import Fix as Fix
from kedge.positioning.fix import Status as Status
from kedge.positioning.fix import bound as position_bound
from kedge.positioning.geometry import Layout as Layout
from kedge.positioning.geometry import layout as layout_of
from kedge.positioning.links import Links as Links
from kedge.positioning.links import Use as Use
from kedge.positioning.links import links as links_of
from kedge.positioning.mixture import Mixture as Mixture
from kedge.positioning.mixture import mixture as solve_mixture
from kedge.positioning.solver import Solver as Solver
from kedge.positioning.solver import solve_all as solve_all

__all__ = [
    "Epochs",
    "Fix",
    "Layout",
    "Links",
    "Mixture",
    "Solver",
    "Status",
    "Use",
    "difference_bound",
    "epochs_of",
    "layout_of",
    "links_of",
    "position_bound",
    "solve_all",
    "solve_differences",
    "solve_mixture",
]

from kedge.calibration.allan import AllanCurve as AllanCurve
from kedge.calibration.allan import AllanFit as AllanFit
from kedge.calibration.allan import allan as allan_deviation
from kedge.calibration.allan import fit as fit_allan
from kedge.calibration.anchors import Delays as Delays
from kedge.calibration.anchors import Line as Line
from kedge.calibration.anchors import antenna_delays as antenna_delays
from kedge.calibration.anchors import calibrate as calibrate_anchors
from kedge.calibration.anchors import fit_line as fit_line
from kedge.calibration.anchors import link_biases as link_biases
from kedge.calibration.anchors import tag_places as tag_places
from kedge.calibration.anchors import usable_pairs as usable_pairs
from kedge.calibration.doppler import Calibration as DopplerCalibration
from kedge.calibration.doppler import calibrate as calibrate_doppler
from kedge.calibration.doppler import typical as typical_calibration
from kedge.calibration.error_curve_files import read_curves as read_curves
from kedge.calibration.error_curve_files import write_curves as write_curves
from kedge.calibration.error_curves import Curve as Curve
from kedge.calibration.error_curves import choose_curve as choose_curve
from kedge.calibration.error_curves import fit_curve as fit_curve
from kedge.calibration.histogram import HistogramFit as HistogramFit
from kedge.calibration.histogram import fit_histogram as fit_histogram
from kedge.calibration.obstacles import Suspicion as Suspicion
from kedge.calibration.obstacles import attenuation as attenuation
from kedge.calibration.obstacles import excess_path as excess_path
from kedge.calibration.obstacles import fit_suspicion as fit_suspicion
from kedge.calibration.obstacles import link_states as link_states
from kedge.calibration.obstacles import separation as separation
from kedge.calibration.placement import Area as Area
from kedge.calibration.placement import area as area
from kedge.calibration.placement import blocked as blocked_links
from kedge.calibration.placement import bounds as position_bounds
from kedge.calibration.placement import chosen as choose_anchors
from kedge.calibration.power_bias import PowerBias as PowerBias
from kedge.calibration.power_bias import fit_power_bias as fit_power_bias
from kedge.calibration.survey import Survey as Survey
from kedge.calibration.survey import self_survey as self_survey

__all__ = [
    "AllanCurve",
    "AllanFit",
    "Area",
    "Curve",
    "Delays",
    "DopplerCalibration",
    "HistogramFit",
    "Line",
    "PowerBias",
    "Survey",
    "Suspicion",
    "allan_deviation",
    "antenna_delays",
    "area",
    "attenuation",
    "blocked_links",
    "calibrate_anchors",
    "calibrate_doppler",
    "choose_anchors",
    "choose_curve",
    "excess_path",
    "fit_allan",
    "fit_curve",
    "fit_histogram",
    "fit_line",
    "fit_power_bias",
    "fit_suspicion",
    "link_biases",
    "link_states",
    "position_bounds",
    "read_curves",
    "self_survey",
    "separation",
    "tag_places",
    "typical_calibration",
    "usable_pairs",
    "write_curves",
]

from kedge.simulation.auv_routes import LawnMower as LawnMower
from kedge.simulation.fault_kinds import Bias as Bias
from kedge.simulation.fault_kinds import Blocked as Blocked
from kedge.simulation.fault_kinds import Clock as Clock
from kedge.simulation.fault_kinds import Delay as Delay
from kedge.simulation.fault_kinds import Drift as Drift
from kedge.simulation.fault_kinds import Dropout as Dropout
from kedge.simulation.fault_kinds import Duplicate as Duplicate
from kedge.simulation.fault_kinds import Excess as Excess
from kedge.simulation.fault_kinds import Jitter as Jitter
from kedge.simulation.fault_kinds import NotANumber as Nan
from kedge.simulation.fault_kinds import Outliers as Outliers
from kedge.simulation.fault_kinds import OutOfOrder as OutOfOrder
from kedge.simulation.fault_kinds import Quantisation as Quantisation
from kedge.simulation.fault_kinds import Stuck as Stuck
from kedge.simulation.routes import Arcs as Arcs
from kedge.simulation.routes import Circle as Circle
from kedge.simulation.routes import FigureOfEight as FigureOfEight
from kedge.simulation.routes import Lane as Lane
from kedge.simulation.routes import Rectangle as Rectangle
from kedge.simulation.routes import Waypoints as Waypoints
from kedge.simulation.scenario import Scenario as Scenario
from kedge.simulation.simulate import Simulation as Simulation
from kedge.simulation.simulate import record as record
from kedge.simulation.simulate import schedule as schedule
from kedge.simulation.simulate import simulate as simulate
from kedge.simulation.simulate import with_readings as with_readings
from kedge.simulation.worlds.auv import UnderwaterWorld as Underwater
from kedge.simulation.worlds.auv_protocol import UnderwaterPath as UnderwaterPath
from kedge.simulation.worlds.auv_protocol import Unpiloted as Unpiloted
from kedge.simulation.worlds.guided_point import GuidedPoint as GuidedPoint
from kedge.simulation.worlds.lane_keeping import LaneKeeping as LaneKeeping
from kedge.simulation.worlds.measured_point import MeasuredPoint as MeasuredPoint
from kedge.simulation.worlds.measured_vehicle import MeasuredVehicle as MeasuredVehicle
from kedge.simulation.worlds.omni_robot import OmniRobot as Omnidirectional
from kedge.simulation.worlds.surveyed_points import SurveyedPoints as SurveyedPoints

__all__ = [
    "Arcs",
    "Bias",
    "Blocked",
    "Circle",
    "Clock",
    "Delay",
    "Drift",
    "Dropout",
    "Duplicate",
    "Excess",
    "FigureOfEight",
    "GuidedPoint",
    "Jitter",
    "Lane",
    "LaneKeeping",
    "LawnMower",
    "MeasuredPoint",
    "MeasuredVehicle",
    "Nan",
    "Omnidirectional",
    "OutOfOrder",
    "Outliers",
    "Quantisation",
    "Rectangle",
    "Scenario",
    "Simulation",
    "Stuck",
    "SurveyedPoints",
    "Underwater",
    "UnderwaterPath",
    "Unpiloted",
    "Waypoints",
    "record",
    "schedule",
    "simulate",
    "with_readings",
]

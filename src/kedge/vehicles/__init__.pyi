from kedge.vehicles.augmented import Drift as Drift
from kedge.vehicles.augmented import augment as augment
from kedge.vehicles.benchmarks.lorenz63 import Lorenz63 as Lorenz63
from kedge.vehicles.benchmarks.lorenz96 import Lorenz96 as Lorenz96
from kedge.vehicles.bicycle import Bicycle as Bicycle
from kedge.vehicles.body_twist import BodyTwist as BodyTwist
from kedge.vehicles.coasting_body import CoastingBody as CoastingBody
from kedge.vehicles.commanded import Commanded as Commanded
from kedge.vehicles.constant_velocity import ConstantVelocity as ConstantVelocity
from kedge.vehicles.constant_velocity import (
    ContinuousWhiteAcceleration as ContinuousWhiteAcceleration,
)
from kedge.vehicles.constant_velocity import (
    DiscreteWhiteAcceleration as DiscreteWhiteAcceleration,
)
from kedge.vehicles.differential_drive import DifferentialDrive as DifferentialDrive
from kedge.vehicles.inertial_point import InertialPoint as InertialPoint
from kedge.vehicles.lateral_tracking import LateralTracking as LateralTracking
from kedge.vehicles.lateral_tracking import LinearLateralTracking as LateralTrackingLinear
from kedge.vehicles.odometry import Odometry as Odometry
from kedge.vehicles.omnidirectional import Omnidirectional as Omnidirectional
from kedge.vehicles.planar_twist import PlanarTwist as PlanarTwist
from kedge.vehicles.still import Still as Still
from kedge.vehicles.strapdown import RatedStrapdown as StrapdownRated
from kedge.vehicles.strapdown import Strapdown as Strapdown
from kedge.vehicles.strapdown_geodetic import GeodeticStrapdown as StrapdownGeodetic
from kedge.vehicles.underwater.coefficient_files import as_coefficients as as_coefficients
from kedge.vehicles.underwater.hull_geometry import Fins as Fins
from kedge.vehicles.underwater.hull_geometry import Hull as Hull
from kedge.vehicles.underwater.hull_geometry import Load as Load
from kedge.vehicles.underwater.hull_geometry import (
    coefficients_from_geometry as coefficients_from_geometry,
)
from kedge.vehicles.underwater.level import LevelTwist as LevelTwist
from kedge.vehicles.underwater.level import LevelUnderwater as UnderwaterLevel
from kedge.vehicles.underwater.underwater import Underwater as Underwater
from kedge.vehicles.unicycle import Unicycle as Unicycle
from kedge.vehicles.wandering import Wandering as Wandering
from kedge.vehicles.wandering import Wandering3 as Wandering3

__all__ = [
    "Bicycle",
    "BodyTwist",
    "CoastingBody",
    "Commanded",
    "ConstantVelocity",
    "ContinuousWhiteAcceleration",
    "DifferentialDrive",
    "DiscreteWhiteAcceleration",
    "Drift",
    "Fins",
    "Hull",
    "InertialPoint",
    "LateralTracking",
    "LateralTrackingLinear",
    "LevelTwist",
    "Load",
    "Lorenz63",
    "Lorenz96",
    "Odometry",
    "Omnidirectional",
    "PlanarTwist",
    "Still",
    "Strapdown",
    "StrapdownGeodetic",
    "StrapdownRated",
    "Underwater",
    "UnderwaterLevel",
    "Unicycle",
    "Wandering",
    "Wandering3",
    "as_coefficients",
    "augment",
    "coefficients_from_geometry",
]

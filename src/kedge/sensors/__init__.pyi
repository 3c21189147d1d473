from kedge.sensors.attitude import AttitudeReference as Attitude
from kedge.sensors.body_velocity import BodyVelocity as BodyVelocity
from kedge.sensors.compass import Compass as Compass
from kedge.sensors.components import Components as Components
from kedge.sensors.depth import Depth as Depth
from kedge.sensors.doppler import Doppler as Doppler
from kedge.sensors.doppler import DopplerThroughWater as DopplerWater
from kedge.sensors.gnss import Gnss as Gnss
from kedge.sensors.gnss3 import Gnss3 as Gnss3
from kedge.sensors.gyroscope import Gyroscope as Gyroscope
from kedge.sensors.heading import PlanarHeading as Heading
from kedge.sensors.landmark_camera import LandmarkCamera as LandmarkCamera
from kedge.sensors.landmark_pose import LandmarkPose as LandmarkPose
from kedge.sensors.landmark_pose import UnwrappedLandmarkPose as LandmarkPoseUnwrapped
from kedge.sensors.landmarks import Landmarks as Landmarks
from kedge.sensors.odometer import Odometer as Odometer
from kedge.sensors.odometry_increment import OdometryIncrement as OdometryIncrement
from kedge.sensors.pose import PlanarPose as Pose
from kedge.sensors.position_velocity import PositionVelocity as PositionVelocity
from kedge.sensors.range_differences import RangeDifferences as RangeDifferences
from kedge.sensors.range_differences import RangeDifferences3 as RangeDifferences3
from kedge.sensors.range_epoch import RangeEpoch as RangeEpoch
from kedge.sensors.ranges import Ranges as Ranges
from kedge.sensors.ranges import Ranges3 as Ranges3
from kedge.sensors.rolling import Rolling as Rolling
from kedge.sensors.squared_ranges import SquaredRanges as SquaredRanges
from kedge.sensors.tracking_error import TrackingError as TrackingError
from kedge.sensors.usbl import Usbl as Usbl
from kedge.sensors.velocity import MapVelocity as Velocity
from kedge.sensors.velocity3 import MapVelocity3 as Velocity3
from kedge.sensors.zero_velocity import ZeroMotion as ZeroMotion
from kedge.sensors.zero_velocity import ZeroRate as ZeroRate
from kedge.sensors.zero_velocity import ZeroVelocity as ZeroVelocity

__all__ = [
    "Attitude",
    "BodyVelocity",
    "Compass",
    "Components",
    "Depth",
    "Doppler",
    "DopplerWater",
    "Gnss",
    "Gnss3",
    "Gyroscope",
    "Heading",
    "LandmarkCamera",
    "LandmarkPose",
    "LandmarkPoseUnwrapped",
    "Landmarks",
    "Odometer",
    "OdometryIncrement",
    "Pose",
    "PositionVelocity",
    "RangeDifferences",
    "RangeDifferences3",
    "RangeEpoch",
    "Ranges",
    "Ranges3",
    "Rolling",
    "SquaredRanges",
    "TrackingError",
    "Usbl",
    "Velocity",
    "Velocity3",
    "ZeroMotion",
    "ZeroRate",
    "ZeroVelocity",
]

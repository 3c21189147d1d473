"""Quantities: array types that know their unit and their chart.

Use these as field annotations. Type checkers and runtime shape checks see a plain array;
:func:`kedge.core.manifolds.space` sees the chart. All units are SI, angles are rad.
"""

from typing import Annotated

from jaxtyping import Array, Float

from kedge.core.manifolds import Circle, Euclidean, Rotation
from kedge.core.manifolds import Within as Within
from kedge.core.rotations import Scalar as Scalar

Position = Annotated[Float[Array, "2"], Euclidean("m", (2,))]
Velocity = Annotated[Float[Array, "2"], Euclidean("m/s", (2,))]
Position3 = Annotated[Float[Array, "3"], Euclidean("m", (3,))]
Velocity3 = Annotated[Float[Array, "3"], Euclidean("m/s", (3,))]
Acceleration2 = Annotated[Float[Array, "2"], Euclidean("m/s^2", (2,))]
Acceleration3 = Annotated[Float[Array, "3"], Euclidean("m/s^2", (3,))]
AngularAcceleration3 = Annotated[Float[Array, "3"], Euclidean("rad/s^2", (3,))]
AngularRate3 = Annotated[Float[Array, "3"], Euclidean("rad/s", (3,))]
Attitude = Annotated[Float[Array, "4"], Rotation()]
Heading = Annotated[Scalar, Circle()]
Bearing = Annotated[Scalar, Circle()]
Range = Annotated[Scalar, Euclidean("m")]
Speed = Annotated[Scalar, Euclidean("m/s")]
Acceleration = Annotated[Scalar, Euclidean("m/s^2")]
YawRate = Annotated[Scalar, Euclidean("rad/s")]
YawAcceleration = Annotated[Scalar, Euclidean("rad/s^2")]
WheelRates = Annotated[Float[Array, "4"], Euclidean("rad/s", (4,))]
SteeringAngle = Annotated[Scalar, Euclidean("rad")]
Force = Annotated[Scalar, Euclidean("N")]
Torque = Annotated[Scalar, Euclidean("N m")]

# Parameters with three axes: one number for all of them, or one each.
AngularRateOffset3 = Annotated[Scalar | Float[Array, "3"], Euclidean("rad/s", (3,))]
AccelerationOffset3 = Annotated[Scalar | Float[Array, "3"], Euclidean("m/s^2", (3,))]
Ratio3 = Annotated[Scalar | Float[Array, "3"], Euclidean("1", (3,))]

# Parameters of models: a plain number in the class body, an array once a driver runs it.
Metres = Annotated[Scalar, Euclidean("m")]
Radians = Annotated[Scalar, Euclidean("rad")]
Radians3 = Annotated[Float[Array, "3"], Euclidean("rad", (3,))]
Seconds = Annotated[Scalar, Euclidean("s")]
Ratio = Annotated[Scalar, Euclidean("1")]
Kilograms = Annotated[Scalar, Euclidean("kg")]
Inertia = Annotated[Scalar, Euclidean("kg m^2")]
Stiffness = Annotated[Scalar, Euclidean("N/rad")]
Curvature = Annotated[Scalar, Euclidean("rad/m")]
WhiteNoise = Annotated[Scalar, Euclidean("1/sqrt(Hz)")]
SpeedNoise = Annotated[Scalar, Euclidean("m/s/sqrt(Hz)")]
WheelRateNoise = Annotated[Scalar, Euclidean("rad/s/sqrt(Hz)")]
AngleNoise = Annotated[Scalar, Euclidean("rad/sqrt(Hz)")]
YawRateNoise = Annotated[Scalar, Euclidean("rad/s/sqrt(Hz)")]
AccelerationNoise = Annotated[Scalar, Euclidean("m/s^2/sqrt(Hz)")]
YawAccelerationNoise = Annotated[Scalar, Euclidean("rad/s^2/sqrt(Hz)")]

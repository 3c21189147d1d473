"""One reading as a filter sees it: target, mount, own noise and missing components bound in."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from kedge.core.contracts import AbstractMeasurementModel, Ranging
from kedge.core.manifolds import space, space_of
from kedge.estimation.log import Readings
from kedge.estimation.rig import Installation
from kedge.numerics.linalg import cholesky, symmetric

NO_READING = -1.0
"""First variance of a reading that is not there."""
NO_COMPONENT = 1e9
"""Variance from which on a component is not there."""


class BoundMeasurement(AbstractMeasurementModel):
    """The measurement model of one reading.

    Missing (NaN) components are replaced by the chart's origin on both sides, with unit noise:
    their residual and every derivative vanish exactly, so the update is that of the components
    that are there, with static shapes, for every filter.
    """

    installation: Installation
    target: Int[Array, ""]
    present: Bool[Array, " m"]
    missing: Any
    """True where a component of the measurement is missing, in the measurement's shape."""
    cov: Float[Array, "m m"] | None
    extra: Float[Array, " m"] | None = None
    """Variances that are added, for errors that it shares with the reading before."""

    def expect(self, state: Any) -> Any:
        """The expected measurement, with the components that are missing left out."""
        expected = self.installation.expect(state, self.target)
        origin, _ = space(expected).complete(
            type(expected)(*(jnp.full(jnp.shape(leaf), jnp.nan) for leaf in expected))
        )
        return type(expected)(
            *(
                jnp.where(gone, zero, leaf)
                for gone, zero, leaf in zip(self.missing, origin, expected, strict=True)
            )
        )

    def noise_cov(self, state: Any) -> Float[Array, "m m"]:
        """The reading's own covariance or the sensor's, without what is missing.

        A component without variance and covariances has the sensor's: nobody knew it.
        """
        cov = self.installation.noise_cov(state, self.target)
        if self.cov is not None:
            # Exactly 0: a NaN is no convention, and stays one.
            known = (self.cov != 0).any(axis=0) | (self.cov != 0).any(axis=1)
            neither = ~known[:, None] & ~known[None, :]
            cov = jnp.where(neither, cov, symmetric(self.cov))
        if self.extra is not None:
            cov = cov + jnp.diag(self.extra)
        both = self.present[:, None] & self.present[None, :]
        return jnp.where(both, cov, jnp.eye(cov.shape[0]))

    def noise_variance(self, state: Any) -> Float[Array, " m"] | None:
        """The sensor's, without what is missing; None if the reading has its own covariance."""
        if self.cov is not None:
            return None
        variance = self.installation.noise_variance(state, self.target)
        if variance is not None and self.extra is not None:
            variance = variance + self.extra
        return None if variance is None else jnp.where(self.present, variance, 1.0)

    def distances(self, state: Any) -> Float[np.ndarray, "m n"] | None:
        """The sensor's."""
        return self.installation.sensor.distances(state)

    def ranging(self, state: Any) -> Ranging | None:
        """The sensor's, without what is missing."""
        ranging = self.installation.ranging(state, self.target)
        return None if ranging is None else ranging._replace(present=self.present)

    def dof(self) -> Int[Array, ""]:
        """How many components are there."""
        return jnp.sum(self.present)

    def possible(self, state: Any, measurement: Any) -> Bool[Array, ""]:
        """Whether the sensor could have read this of its target; NaN is what is missing."""
        seen = self.installation.sensor.for_target(self.target)
        pairs = zip(self.missing, measurement, strict=True)
        read = type(measurement)(*(jnp.where(gone, jnp.nan, leaf) for gone, leaf in pairs))
        return jnp.asarray(seen.possible(state, read))

    def source(self) -> str:
        """The sensor's name."""
        return self.installation.name


def bind_reading(installation: Installation, reading: Readings) -> tuple[BoundMeasurement, Any]:
    """Bind one reading to its sensor; return the model and the completed measurement."""
    outputs = space_of(installation.sensor.measures)
    reading = without_absent(reading)
    measurement, present = outputs.complete(reading.measurement)
    missing = type(measurement)(
        *(
            jnp.broadcast_to(jnp.isnan(leaf).any(), jnp.shape(leaf))
            if chart.shape != chart.tangent_shape
            else jnp.isnan(leaf)
            for chart, leaf in zip(outputs.charts, reading.measurement, strict=True)
        )
    )
    target = jnp.maximum(reading.target, 0)
    return BoundMeasurement(installation, target, present, missing, reading.cov), measurement


def without_absent(reading: Readings) -> Readings:
    """The reading without the components that its covariance says are not there.

    By the conventions of ROS messages: -1 as the first variance says that of all; drivers write
    1e9 or the largest number there is as the variance of a single one.

    Source: Open Robotics, "sensor_msgs/Imu" of common_interfaces, comments of the definition.
    """
    if reading.cov is None:
        return reading
    variance = jnp.diag(reading.cov)
    absent = (variance >= NO_COMPONENT) | (variance[:1] == NO_READING)
    leaves, start = [], 0
    for chart, leaf in zip(space(reading.measurement).charts, reading.measurement, strict=True):
        part = absent[start : start + chart.size]
        start += chart.size
        one_each = chart.shape == chart.tangent_shape
        gone = part.reshape(chart.shape) if one_each else part.any()
        leaves.append(jnp.where(gone, jnp.nan, leaf))
    return reading._replace(measurement=type(reading.measurement)(*leaves))


def is_positive_definite(cov: Float[Array, "m m"]) -> Bool[Array, ""]:
    """Whether a covariance that came with a reading can be used."""
    return jnp.isfinite(cholesky(cov)).all() & jnp.isfinite(cov).all()

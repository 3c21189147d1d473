"""Verdicts: what became of each reading. They are data, written beside every estimate."""

import enum


class Verdict(enum.IntEnum):
    """What became of one reading.

    The values are stored in logs and traced code; never renumber them.
    """

    FUSED = 0
    """Used as it is."""
    GATED = 1
    """Too unlikely under the prediction: beyond the gate."""
    LATE = 2
    """Older than what the estimator can still take in."""
    DUPLICATE = 3
    """The same source, time, target and values as a reading already seen."""
    FUTURE = 4
    """Stamped further ahead than the estimator allows."""
    NOT_FINITE = 5
    """Nothing usable in it (missing, infinite, or what no state explains, such as a range that
    is shorter than the difference of heights), or an update that would not be finite."""
    BAD_COVARIANCE = 6
    """The covariance that came with it is not positive definite."""
    UNKNOWN_TARGET = 7
    """It names a target that is not on the map."""
    DROPPED = 8
    """Left out on purpose: by the filter (dead reckoning) or by a policy."""
    UNPREDICTED = 9
    """The prediction to it was not finite, or had a negative variance: the belief before that
    was kept, and the next prediction is over the whole time since."""

    NONE = -1
    """The event carried no reading."""

"""What a rig file may say of the prior's attitude and covariance."""

from collections.abc import Iterator

import numpy as np

from kedge.formats.attitudes import TOLERANCE


def attitude_errors(key: str, values: list[float]) -> Iterator[str]:
    """Neither a unit quaternion nor three angles."""
    if len(values) not in (3, 4):
        yield (
            f"{key}: found {len(values)} numbers, expected the 4 of a unit quaternion "
            "(w, x, y, z) or roll, pitch and heading in rad"
        )
    elif len(values) == 4 and abs((length := float(np.linalg.norm(values))) - 1) > TOLERANCE:
        yield f"{key}: found a quaternion of length {length:.3g}, expected 1"


def covariance_errors(rows: list[list[float]], size: int) -> Iterator[str]:
    """Another size, not symmetric, not positive definite."""
    if [len(row) for row in rows] != [size] * size:
        yield f"prior.covariance: expected {size} rows of {size} numbers"
        return
    cov = np.array(rows)
    if not np.allclose(cov, cov.T, rtol=1e-9, atol=0):
        yield "prior.covariance: not symmetric, expected a covariance"
    elif (least := float(np.linalg.eigvalsh(cov)[0])) <= 0:
        yield (
            f"prior.covariance: not positive definite: found the eigenvalue {least:.6g}, "
            "expected all above 0"
        )

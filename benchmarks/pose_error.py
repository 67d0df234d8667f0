"""The normalised error of a pose (NEES), as several benchmarks count it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import rootmatch as rm


def squared_error(pose: rm.Pose, R: NDArray[np.float64], t: NDArray[np.float64]) -> float:
    """Squared deviation of a pose from the true one over its covariance, which has full rank."""
    assert pose.covariance is not None
    off = np.concatenate([Rotation.from_matrix(R @ pose.R.T).as_rotvec(), t - pose.t])
    return float(off @ np.linalg.solve(pose.covariance, off))

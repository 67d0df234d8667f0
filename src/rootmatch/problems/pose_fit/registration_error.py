"""How far off a fitted motion puts points that took no part in its fit: the target registration error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.algebra.rotation import angle_count, turn_jacobian
from rootmatch.arrays import Floats
from rootmatch.cameras.pinhole import check_rows
from rootmatch.errors import InputError


@dataclass(frozen=True, eq=False)
class RegistrationError:
    """Expected error of points, as `Pose.tre` gives it.

    Parameters
    ----------
    covariance : (…, k, k) array
        Of the error of each point in the target frame.
    """

    covariance: Floats

    @property
    def rms(self) -> Floats:
        """Root mean square of the distance of each point (…,) from where it should be: the TRE that is quoted."""
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=-2, axis2=-1)))


def registration_error(R: Floats, scale: float, covariance: Floats | None, points: ArrayLike) -> RegistrationError:
    """The expected error of points (…, k) that a pose moves; see `Pose.tre`."""
    k = len(R)
    if covariance is None:
        raise InputError("pose: no covariance, so no error is known; use match.pose, or Pose(R, t, covariance)")
    x = check_rows(points, k, "pose", "points")
    if not np.all(np.isfinite(x)):
        raise InputError(f"pose: points with NaN or infinity given; give finite numbers (…, {k})")
    turned = x @ R.T
    turns = angle_count(k)
    jacobian = np.zeros((*x.shape, len(covariance)))
    jacobian[..., :turns] = turn_jacobian(scale * turned)
    jacobian[..., turns : turns + k] = np.eye(k)
    if len(covariance) > turns + k:
        jacobian[..., -1] = turned
    return RegistrationError(jacobian @ covariance @ jacobian.swapaxes(-1, -2))

"""The stereographic chart: nearly the whole sphere of directions on one plane, on which small circles stay circles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.algebra.directions import tangent_basis_at
from rootmatch.arrays import Bools, Floats
from rootmatch.cameras.base import CameraModel

ANTIPODE = 1e-12
"""1 + cosine to the axis below which a direction is opposite to it, and infinitely far away. Rounding; not tuned."""


@dataclass(frozen=True, eq=False)
class Stereographic(CameraModel):
    """A camera that sees everything but the direction opposite to its axis.

    A direction at an angle θ to the axis lies at 2 tan(θ/2). That is conformal: isotropic noise stays isotropic.
    """

    basis: Floats
    """(3, 3) rows: the two axes of the plane and the axis of the camera, orthonormal."""
    dimension = 2
    focal = 1.0
    """Units of the plane per radian, on the axis."""

    @classmethod
    def about(cls, rays: Floats) -> Stereographic:
        """The chart of unit rays (m, 3) about the direction whose opposite is farthest from all of them."""
        x, y, z = widest_axis(rays).tolist()
        return cls(np.array([*tangent_basis_at(x, y, z), (x, y, z)]))

    def bearings(self, pixels: ArrayLike) -> Floats:
        """See `CameraModel.bearings`."""
        plane = np.asarray(pixels, dtype=float)
        quarter = 0.25 * (plane * plane).sum(axis=-1, keepdims=True)
        rotated = np.concatenate([plane, 1.0 - quarter], axis=-1) / (1.0 + quarter)
        return np.asarray(rotated @ self.basis)

    def project(self, points: ArrayLike) -> Floats:
        """See `CameraModel.project`."""
        rotated = np.asarray(points, dtype=float) @ self.basis.T
        size = np.linalg.norm(rotated, axis=-1, keepdims=True)
        return np.asarray(2.0 * rotated[..., :2] / (size + rotated[..., 2:]))

    def sees(self, points: ArrayLike) -> Bools:
        """See `CameraModel.sees`."""
        xyz = np.asarray(points, dtype=float)
        size = np.linalg.norm(xyz, axis=-1)
        return np.asarray(size + xyz @ self.basis[2] > ANTIPODE * size)

    def jacobian(self, points: ArrayLike) -> Floats:
        """See `CameraModel.jacobian`."""
        rotated = np.asarray(points, dtype=float) @ self.basis.T
        size = np.linalg.norm(rotated, axis=-1, keepdims=True)
        total = size + rotated[..., 2:]
        by_total = rotated / size + np.array([0.0, 0.0, 1.0])
        out = -2.0 * rotated[..., :2, None] * (by_total / (total * total))[..., None, :]
        out[..., 0, 0] += 2.0 / total[..., 0]
        out[..., 1, 1] += 2.0 / total[..., 0]
        return np.asarray(out @ self.basis)


def widest_axis(rays: Floats) -> Floats:
    """A unit vector (3,) whose angle to the farthest of some unit rays (m, 3) is small: their mean, or another one."""
    mean = rays.sum(axis=0)
    size = float(np.linalg.norm(mean))
    tried = [mean / size] if size > 1e-9 * len(rays) else []
    if not tried or float((rays @ tried[0]).min()) < 0.0:
        steps = (-1.0, 0.0, 1.0)
        cube = np.array([(x, y, z) for x in steps for y in steps for z in steps if (x, y, z) != (0.0, 0.0, 0.0)])
        tried += list(cube / np.linalg.norm(cube, axis=1, keepdims=True))
    return np.asarray(tried[int(np.argmax([float((rays @ axis).min()) for axis in tried]))])

"""The perspective three-point problem: points in space and their image in one calibrated camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Floats, Integers, cache_by_values
from rootmatch.cameras.base import CameraModel, check_camera
from rootmatch.cameras.rig import Rig
from rootmatch.problems.base import Problem
from rootmatch.problems.checks import check_not_collinear
from rootmatch.problems.points import PointSets, normals_with_cosines, squared_distances
from rootmatch.problems.pose_fit.camera_fit import camera_poses
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.rig_fit import rig_poses

if TYPE_CHECKING:
    from rootmatch.problems.p3p.tables import P3PTables

KEPT_POINTS = 64
"""Points up to which their distances are kept for the next frame: 32 kB. A round value."""


@dataclass(frozen=True)
class P3P(Problem):
    """Pose of a calibrated camera from three points (Fischler & Bolles 1981; paper, section "P3P").

    Pass it to `rootmatch.match`; its methods are only needed to write problems or samplers.

    The unknown shared by the two triples abc and abd of a hyper-edge is x = b/a, the ratio of the distances of points
    b and a from the camera centre.

    Parameters
    ----------
    camera : Camera
        A `rootmatch.Rig` works too.

    Raises
    ------
    InputError
        If ``camera`` is not a camera.

    Notes
    -----
    The source is points (n, 3) in any frame and unit, the target pixels (n', 2). The pose takes the points into the
    camera frame (x right, y down, z forward), in their unit.

    Degenerate: all points of the model on one line (refused by `prepare`); a triple on one line, or a camera on the
    cylinder through a triple (a double root: the residual's variance grows, so its weight decreases); D(x) = 0, where
    two solutions share x. The visible points may lie on one line although those of the model do not: a match is then
    right only up to reversing the line, and the rotation about it is not determined. The reversed ("inside-out") pose
    is a solution of the same polynomials: see `Match.alternatives`.
    """

    camera: CameraModel
    name: ClassVar[str] = "p3p"
    minimal: ClassVar[int] = 3
    degree: ClassVar[int] = 4
    constraints: ClassVar[int] = 2
    source_dimension: ClassVar[int] = 3
    to_check: ClassVar[str] = "the units and the camera"
    to_tell: ClassVar[str] = "give normals, or a vertical (`UP2P`)"
    takes_normals: ClassVar[bool] = True
    takes_prior: ClassVar[bool] = True
    min_for_pose: ClassVar[int] = 4

    def __post_init__(self) -> None:
        check_camera(self.camera, rigs=True)
        self._take_dimensions(self.camera)

    def tables(self, points: PointSets) -> P3PTables:
        """Tables for the kernels; see `Problem.tables`."""
        from rootmatch.problems.p3p.tables import P3PTables  # takes Numba, which a bad file should not wait for

        source = points.source
        few = len(source) <= KEPT_POINTS
        distance2, places = _kept_distances(source) if few else _distances(source)
        rays = self.camera.bearings(points.target)
        versine = squared_distances(rays)
        versine *= 0.5
        return P3PTables(
            distance2=distance2,
            points=places,
            versine=versine,
            rays=np.ascontiguousarray(rays.T),
            variance=self.camera.angular_noise(points.target, points.target_noise, rays) ** 2,
            normals=normals_with_cosines(points),
        )

    def of_view(self, camera: CameraModel, turn: Floats) -> P3P:
        """The problem of one camera of a rig; ``turn``: its rotation in it, which is not known to this problem."""
        return replace(self, camera=camera)

    def poses(self, points: PointSets, assignments: Integers) -> list[Pose | None]:
        """Camera poses, 6 × 6 covariances; see `Problem.poses`."""
        if isinstance(self.camera, Rig):
            return rig_poses(points, self.camera, assignments)
        return camera_poses(points, self.camera, assignments)

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> Floats:
        """Polynomials of minimal sets; see `Problem.coefficients`."""
        from rootmatch.problems.p3p.quartic import quartic_in_ratio

        points = np.asarray(source, dtype=float)
        rays = self.camera.bearings(target)
        side = [((points[:, (k + 1) % 3] - points[:, k]) ** 2).sum(axis=1) for k in range(3)]  # ab, bc, ca
        versine = [0.5 * ((rays[:, (k + 1) % 3] - rays[:, k]) ** 2).sum(axis=1) for k in range(3)]
        # the scalar kernel is plain arithmetic, so its Python form takes whole arrays
        return np.array([quartic_in_ratio(*values) for values in zip(*side, *versine, strict=True)])


def _distances(source: Floats) -> tuple[Floats, Floats]:
    """Squared distances (n, n) of source points in a common unit, and the points (3, n) in it.

    The unit keeps polynomials of kilometres and of millimetres alike.
    """
    check_not_collinear(source)
    places = source - source.mean(axis=0)
    places /= np.sqrt((places**2).mean())
    return squared_distances(places), np.ascontiguousarray(places.T)


_kept_distances = cache_by_values(16)(_distances)

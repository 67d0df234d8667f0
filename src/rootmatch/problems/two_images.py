"""What the problems between two images share: two cameras that know one common direction, and their relative pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Floats, Integers
from rootmatch.cameras.base import CameraModel, check_camera
from rootmatch.cameras.vertical import IN_BOTH_IMAGES, Vector, check_direction, rotation_to_vertical
from rootmatch.problems.base import Problem
from rootmatch.problems.points import PointSets, TwoViews
from rootmatch.problems.pose_fit.epipolar_lines import Views
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.two_view_pose import two_view_poses


@dataclass(frozen=True)
class TwoImageProblem(Problem):
    """A problem between two calibrated images; parameters as of `rootmatch.ThreePlusOne`.

    Pixels of the first image are the source, of the second the target.
    """

    camera: CameraModel
    camera2: CameraModel | None = None
    axis: Vector = ()
    axis2: Vector = ()
    planar: ClassVar[bool] = False
    """Whether the camera moves at right angles to the common direction."""
    source_dimension: ClassVar[int] = 2
    to_check: ClassVar[str] = "the cameras and the axes"
    noisy_source: ClassVar[bool] = True
    source_is_image: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_camera(self.camera)
        if self.camera2 is not None:
            check_camera(self.camera2, "camera2")
        self._take_dimensions(self.camera, self.camera2)
        self.__dict__.update(
            axis=check_direction(self.axis, "axis", self.name, IN_BOTH_IMAGES),
            axis2=check_direction(self.axis2, "axis2", self.name, IN_BOTH_IMAGES),
        )

    @property
    def cameras(self) -> tuple[CameraModel, CameraModel]:
        """Cameras of the first and of the second image."""
        return self.camera, self.camera2 or self.camera

    @property
    def tilt_variance(self) -> float:
        """Variance of the axis of one view against that of the other, radians² on each of two directions."""
        return 0.0

    def rotations(self) -> tuple[Floats, Floats]:
        """Rotations of the first and of the second camera frame that bring their axes onto the y axis."""
        return rotation_to_vertical(self.axis, "axis"), rotation_to_vertical(self.axis2, "axis2")

    def rays(self, source: ArrayLike, target: ArrayLike) -> tuple[Floats, Floats]:
        """Unit bearings (…, 3) of pixels of the first and of the second image, the axis of either turned onto y."""
        (camera, camera2), (rotation, rotation2) = self.cameras, self.rotations()
        return camera.bearings(source) @ rotation.T, camera2.bearings(target) @ rotation2.T

    def two_views(self, points: PointSets) -> TwoViews | None:
        """See `Problem.two_views`; what the direction's noise does to a bearing is counted with the source."""
        (camera, camera2), (first, second) = self.cameras, self.rays(points.source, points.target)
        return TwoViews(
            np.ascontiguousarray(first.T),
            np.ascontiguousarray(second.T),
            camera.angular_noise(points.source, points.source_noise) ** 2 + self.tilt_variance,
            camera2.angular_noise(points.target, points.target_noise) ** 2,
            self.planar,
        )

    def poses(self, points: PointSets, assignments: Integers) -> list[Pose | None]:
        """Poses of the second view in the first, t of length 1; see `Problem.poses`.

        The 6 × 6 covariance has rank 3, that of the angle about the axis and of the direction of t; rank 2 if t is
        planar, and two more if the axes are noisy.
        """
        views = Views.of(points, self.cameras, self.rotations(), math.sqrt(self.tilt_variance))
        return two_view_poses(views, self.rotations(), points.target, assignments, self.planar)

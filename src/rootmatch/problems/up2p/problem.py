"""The upright two-point problem: points in space and their image in a camera whose vertical is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.cameras.base import CameraModel, check_camera
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.vertical import Vector, check_direction, rotation_to_vertical, warn_of_degrees
from rootmatch.errors import InputError
from rootmatch.problems.base import Problem
from rootmatch.problems.p3p import P3P
from rootmatch.problems.points import PointSets, normals_with_cosines
from rootmatch.problems.pose_fit.camera_fit import camera_poses
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.prior_residuals import Upright
from rootmatch.problems.pose_fit.rig_fit import rig_poses

if TYPE_CHECKING:
    from rootmatch.problems.up2p.group_fit import UprightGroups
    from rootmatch.problems.up2p.tables import UP2PTables


@dataclass(frozen=True)
class UP2P(Problem):
    """Pose of a calibrated upright camera from two points (Kukelova et al. 2011; paper, section "up2p").

    Pass it to `rootmatch.match`; its methods are only needed to write problems or samplers.

    The unknown is x = tan(θ/2) of the rotation θ about the vertical; it belongs to the camera, so all pairs share it.

    Parameters
    ----------
    camera : Camera
        A `Rig` works too; its frame then takes the place of the camera's.
    vertical_camera, vertical_world : three floats
        The same direction (for example down) in the camera frame and in the frame of the points, measured by an
        inertial sensor or known by construction. Any length but 0; there is no default. A body or a frame with a
        vertical of its own has it as a `PosePrior`, which takes the place of this one.
    vertical_noise : float
        Standard deviation in radians of that direction on each of two axes; it enters the residuals' variance.

    Raises
    ------
    InputError
        If ``camera`` is not a camera, a direction is missing, is not three finite numbers or has length 0, or the noise
        is out of range.

    Notes
    -----
    The source is points (n, 3) in any frame and unit, the target pixels (n', 2). The pose takes the points into the
    camera frame (x right, y down, z forward), in their unit.

    Degenerate: both points on one vertical line (all coefficients vanish: such a pair carries no information and gets a
    large residual); both at the same height and imaged at the same height (θ and θ + π fit equally well); θ = π puts x
    at infinity, which harms only ``"qr"``.
    """

    camera: CameraModel
    vertical_camera: Vector = ()
    vertical_world: Vector = ()
    vertical_noise: float = 0.0
    name: ClassVar[str] = "up2p"
    minimal: ClassVar[int] = 2
    degree: ClassVar[int] = 2
    constraints: ClassVar[int] = 2
    source_dimension: ClassVar[int] = 3
    to_check: ClassVar[str] = "the units, the camera and both verticals"
    to_tell: ClassVar[str] = "give normals"
    paper_rho: ClassVar[float] = 1e-2
    takes_normals: ClassVar[bool] = True
    takes_prior: ClassVar[bool] = True
    min_for_pose: ClassVar[int] = 3

    def __post_init__(self) -> None:
        check_camera(self.camera, rigs=True)
        self._take_dimensions(self.camera)
        self.__dict__.update(
            vertical_camera=check_direction(self.vertical_camera, "vertical_camera", self.name),
            vertical_world=check_direction(self.vertical_world, "vertical_world", self.name),
        )
        if not (0.0 <= self.vertical_noise < 1.0):
            raise InputError(
                f"vertical_noise: {self.vertical_noise} given; give radians from 0 to 1, such as np.radians(1.0) for 1°"
            )
        warn_of_degrees("vertical_noise", float(self.vertical_noise))

    def rotations(self) -> tuple[Floats, Floats]:
        """Rotations of world and of camera that bring their verticals onto the y axis."""
        return (
            rotation_to_vertical(self.vertical_world, "vertical_world"),
            rotation_to_vertical(self.vertical_camera, "vertical_camera"),
        )

    @property
    def upright(self) -> Upright:
        """The vertical as a fit takes it."""
        return Upright(*self.rotations(), float(self.vertical_noise))

    def tables(self, points: PointSets) -> UP2PTables:
        """Tables for the kernels; see `Problem.tables`."""
        from rootmatch.problems.up2p.tables import UP2PTables  # takes Numba, which a bad file should not wait for

        world, camera = self.rotations()
        rays = self.camera.bearings(points.target) @ camera.T
        # sums and extremes: `mean` and `ptp` take three times as long for few points
        centred = (points.source - points.source.sum(axis=0) / len(points.source)) @ world.T
        extent = centred.max(axis=0) - centred.min(axis=0)
        if max(extent[0], extent[2]) <= 1e-9 * np.abs(centred).max():
            raise InputError(
                "source: all points lie on one vertical line, which leaves the rotation open; add points off it"
            )
        return UP2PTables(
            points=np.ascontiguousarray((centred / np.sqrt((centred**2).sum() / centred.size)).T),
            rays=np.ascontiguousarray(rays.T),
            variance=self.camera.angular_noise(points.target, points.target_noise) ** 2,
            tilt_variance=np.array([float(self.vertical_noise) ** 2]),
            normals=normals_with_cosines(points, world),
        )

    def without_vertical(self, points: PointSets) -> Callable[[], Any] | None:
        """See `Problem.without_vertical`: those of `P3P`, where the vertical is measured."""
        few = min(len(points.source), len(points.target)) <= self.minimal + 1
        return None if few or self.vertical_noise == 0.0 else partial(P3P(self.camera).tables, points)

    def of_view(self, camera: CameraModel, turn: Floats) -> UP2P:
        """The problem of one camera of a rig, which has the rotation ``turn`` (3, 3) in it."""
        vertical = turn @ np.array(self.vertical_camera)
        return replace(self, camera=camera, vertical_camera=tuple(vertical.tolist()))

    def groups(self, points: PointSets, allowed: Bools | None) -> UprightGroups:
        """See `Problem.groups`."""
        from rootmatch.problems.up2p.group_fit import UprightGroups

        tables = self.tables(points)
        return UprightGroups(tables.points, tables.rays, tables.variance + tables.tilt_variance, allowed)

    def poses(self, points: PointSets, assignments: Integers) -> list[Pose | None]:
        """Camera poses; see `Problem.poses`.

        Their 6 × 6 covariances have rank 4 where the vertical is exact: no rotation but that about it is uncertain.
        That of a rig is fitted without the vertical.
        """
        if isinstance(self.camera, Rig):
            return rig_poses(points, self.camera, assignments)
        return camera_poses(points, self.camera, assignments, self.upright)

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> Floats:
        """Polynomials of minimal sets; see `Problem.coefficients`."""
        from rootmatch.problems.up2p.quadratic import quadratic

        world, camera = self.rotations()
        rays = self.camera.bearings(target) @ camera.T
        points = np.asarray(source, dtype=float)
        difference = (points[:, 1] - points[:, 0]) @ world.T
        return np.array([quadratic(d, u, v) for d, u, v in zip(difference, rays[:, 0], rays[:, 1], strict=True)])

"""Upright pose with unknown focal length: points in space and their image, the vertical known, the zoom not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.cameras.pinhole import Camera
from rootmatch.cameras.vertical import Vector, check_direction, rotation_to_vertical
from rootmatch.errors import InputError
from rootmatch.problems.base import Problem
from rootmatch.problems.derived.measurements import Points, Uncalibrated, as_nested_tuples
from rootmatch.problems.derived.problem import DerivedProblem
from rootmatch.problems.derived.store import shipped_formulas
from rootmatch.problems.derived.tables import DerivedTables
from rootmatch.problems.points import PointSets
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.prior_residuals import Upright
from rootmatch.problems.pose_fit.zoom_pose import zoom_poses
from rootmatch.problems.up2p import UP2P
from rootmatch.problems.up2pf.focal_lengths import focal_grid, search_noise, usual_focal


@dataclass(frozen=True)
class UP2PF(Problem):
    """Pose and focal length of an upright camera with square pixels and a known principal point.

    Pass it to `rootmatch.match`; its methods are only needed to write problems or samplers.

    If the vertical is known, the correspondence of a point X and a pixel gives two equations in the rotation angle θ
    about the vertical, the translation and the focal length f (compare Kukelova et al. 2010, who add radial
    distortion). Three points determine the five unknowns and leave one constraint; a hyper-edge of four has three. The
    translation is eliminated from each pair of points as in `UP2P`, which leaves an equation that is linear in f; f is
    eliminated between two of these. The unknown that all share is x = tan(θ/2).

    Parameters
    ----------
    centre : two floats
        Principal point in pixels.
    vertical_camera, vertical_world : three floats
        The same direction (for example down) in the camera frame and in the frame of the points, taken as exact. Any
        length but 0; there is no default.

    Raises
    ------
    InputError
        If ``centre`` is not two numbers, or a direction is missing, is not three finite numbers or has length 0.

    Notes
    -----
    The source is points (n, 3) in any frame and unit, the target pixels (n', 2) of an image without distortion. The
    pose takes the points into the camera frame (x right, y down, z forward); `Pose.focal` is in pixels.

    Degenerate: no perspective, that is, points at nearly one depth: focal length and distance can be traded for each
    other and only their ratio is determined, so residuals lose their power; two points of a minimal set on one vertical
    line; θ = π puts x at infinity. Both signs of f solve the equations; only f > 0 is accepted.
    """

    centre: tuple[float, float]
    vertical_camera: Vector = ()
    vertical_world: Vector = ()
    name: ClassVar[str] = "up2pf"
    minimal: ClassVar[int] = 3
    degree: ClassVar[int] = 4
    constraints: ClassVar[int] = 3
    source_dimension: ClassVar[int] = 3
    min_for_pose: ClassVar[int] = 4
    to_check: ClassVar[str] = "the units, the centre and both verticals"
    to_tell: ClassVar[str] = "use `UP2P` if the focal length is known"

    def __post_init__(self) -> None:
        self.__dict__.update(
            vertical_camera=check_direction(self.vertical_camera, "vertical_camera", self.name),
            vertical_world=check_direction(self.vertical_world, "vertical_world", self.name),
        )
        centre = np.asarray(self.centre, dtype=float)
        if centre.shape != (2,) or not np.all(np.isfinite(centre)):
            raise InputError(f"centre: {self.centre!r} given; give the principal point, two numbers of pixels")
        self.__dict__.update(centre=(float(centre[0]), float(centre[1])))

    @property
    def derived(self) -> DerivedProblem:
        """The generated problem behind it, on points and rays turned so that the vertical is y."""
        camera = rotation_to_vertical(self.vertical_camera, "vertical_camera")
        # a turn about y is what is unknown anyway: one that brings the optical axis into the plane x = 0 saves a symbol
        axis = camera[:, 2]
        size = float(np.hypot(axis[0], axis[2]))
        if size > 0.0:
            c, s = axis[2] / size, axis[0] / size
            camera = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) @ camera
        return DerivedProblem(
            self.name, shipped_formulas("up2pf"), Points(3), Uncalibrated(self.centre, as_nested_tuples(camera))
        )

    def tables(self, points: PointSets) -> DerivedTables:
        """Tables for the kernels; see `Problem.tables`."""
        # a common unit and origin keep polynomials of kilometres and of millimetres alike
        centred = points.source - points.source.mean(axis=0)
        centred /= np.sqrt((centred**2).mean())
        return self.derived.tables(replace(points, source=self._rotate_source(centred)))

    def at_focal_lengths(self, points: PointSets) -> Callable[[], list[Any]] | None:
        """See `Problem.at_focal_lengths`: those of `UP2P`, which takes no points that are all on one vertical line."""
        turned = self._rotate_source(points.source - points.source.mean(axis=0))
        off_line = np.abs(turned[:, [0, 2]]).max() > 1e-8 * np.abs(turned).max()
        return partial(self._tables_at_focal_lengths, points) if off_line else None

    def _tables_at_focal_lengths(self, points: PointSets) -> list[Any]:
        """Those tables."""
        centre = np.array(self.centre)
        noise = search_noise(centre, points.target, points.target_noise)
        every = []
        for focal in focal_grid(centre, points.target).tolist():
            camera = Camera(focal, focal, *self.centre)
            known = UP2P(camera, self.vertical_camera, self.vertical_world)
            every.append(known.tables(replace(points, target_noise=noise)))
        return every

    @property
    def upright(self) -> Upright:
        """The vertical as a fit takes it."""
        return Upright(
            rotation_to_vertical(self.vertical_world, "vertical_world"),
            rotation_to_vertical(self.vertical_camera, "vertical_camera"),
            0.0,
        )

    def poses(self, points: PointSets, assignments: NDArray[np.int64], start: Pose | None = None) -> list[Pose | None]:
        """Poses with focal lengths; see `Problem.poses`.

        The seventh row and column of the covariance are those of the focal length; the others have rank 4. From
        ``start``, if it is given, the poses are those of its valley.
        """
        centre = np.array(self.centre)
        usual = usual_focal(centre, points.target)
        return zoom_poses(points, centre, self.upright, assignments, start, usual=usual)

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """Quartics (E, 5) in x, θ counted from the optical axis, of minimal sets (E, 3, 3) and (E, 3, 2)."""
        return self.derived.coefficients(self._rotate_source(source), target)

    def _rotate_source(self, source: ArrayLike) -> Any:
        points = np.asarray(source)
        if points.ndim < 2 or points.shape[-1] != 3 or points.dtype.kind not in "fiu":
            return source  # the checks further on say what is wrong
        return points @ rotation_to_vertical(self.vertical_world, "vertical_world").T

"""Congruence and similarity: point sets of one space that a rigid motion, or a scaled one, takes to each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Floats, Integers
from rootmatch.errors import InputError
from rootmatch.problems.base import Problem
from rootmatch.problems.noise import pixel_equivalent
from rootmatch.problems.points import PointClouds, PointSets, distances
from rootmatch.problems.pose_fit.point_set_pose import point_set_pose
from rootmatch.problems.pose_fit.pose import Pose

if TYPE_CHECKING:
    from rootmatch.problems.similarity.tables import SimilarityTables


@dataclass(frozen=True)
class Similarity(Problem):
    """Points of a plane or of space, matched up to rotation, translation and an unknown scale.

    Pass it to `rootmatch.match`; its methods are only needed to write problems or samplers.

    The unknown is the scale x; a pair of points gives e = x d of its distances d and e, so all pairs share it. A
    hyper-edge of three has two constraints, the shape of a triangle.

    Parameters
    ----------
    dimension : int, optional
        2 or 3, for both sets; by default that of the source points.
    mirror : bool
        Whether a mirrored set matches too: the motion may then be a reflection. In space the guided search, of
        large sets, finds rotations only.

    Raises
    ------
    InputError
        If ``dimension`` is neither 2 nor 3.

    Notes
    -----
    The noise is the standard deviation of a coordinate, in the unit of its own set. One number holds for both sets; n'
    numbers are those of the target, and the source gets their root mean square; a pair gives source and target
    separately (``noise=(0.0, 0.1)`` for an exact model).

    The pose is the most likely motion of the source onto the target. In space three points have no handedness, so the
    hyper-edges of a mirrored set agree; without ``mirror`` no pose fits it, and the match is not trusted.

    The search takes triples of either set, finds similar triangles in the other and judges the motion of each by all
    points: 100 points against 100 take up to a second, or a fifth of that if the scale is known.

    Exact fiducials of a plan (CT) against a tracker's points with 0.2 mm of noise, some missing and some stray::

        match = rm.match(plan, measured, rm.Rigid(), noise=(0.0, 0.2))
        (pose,) = match.poses  # R, t from plan to tracker, 6 × 6 covariance, RMS in mm

    Degenerate: three points on a line (their equations are dependent, so they get a large residual and no weight); two
    points closer than the noise; symmetric sets, which match in several ways.
    """

    dimension: int | None = None
    mirror: bool = False
    name: ClassVar[str] = "similarity"
    minimal: ClassVar[int] = 2
    degree: ClassVar[int] = 1
    constraints: ClassVar[int] = 2
    to_check: ClassVar[str] = "the units of both sets"
    min_for_pose: ClassVar[int] = 3
    noisy_source: ClassVar[bool] = True
    takes_motion_prior: ClassVar[bool] = True
    predicted_rows: ClassVar[int] = 7
    scale: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        if self.dimension not in (None, 2, 3):
            raise InputError(f"dimension: {self.dimension!r} given; 2 or 3 expected")
        # 0 until `for_points` settles it
        self.__dict__.update(source_dimension=self.dimension or 0, target_dimension=self.dimension or 0)

    def for_points(self, source: ArrayLike) -> Similarity:
        """See `Problem.for_points`."""
        if self.dimension is not None:
            return self
        try:
            shape = np.shape(source)
        except ValueError:
            shape = ()
        if len(shape) < 2 or shape[-1] not in (2, 3):
            raise InputError(f"source: shape {shape} given, (m, 2) or (m, 3) expected")
        return replace(self, dimension=int(shape[-1]))

    def noise_pixels(self, source: Floats, target: Floats) -> tuple[float, float]:
        """See `Problem.noise_pixels`."""
        return pixel_equivalent(source), pixel_equivalent(target)

    def tables(self, points: PointSets) -> SimilarityTables:
        """Tables for the kernels; see `Problem.tables`. Both sets have rows of ``dimension`` coordinates."""
        from rootmatch.problems.similarity.tables import (
            SimilarityTables,
        )  # takes Numba, which a bad file should not wait for

        first, second = points.source, points.target
        oriented = first.shape[1] == 2 and not self.mirror
        return SimilarityTables(
            source=distances(first),
            target=distances(second),
            source_variance=points.source_noise**2,
            target_variance=points.target_noise**2,
            source_points=np.ascontiguousarray(first[:, :2].T) if oriented else np.zeros((2, len(first))),
            target_points=np.ascontiguousarray(second[:, :2].T) if oriented else np.zeros((2, len(second))),
            scale=np.array([self.scale]),
        )

    def point_clouds(self, points: PointSets) -> PointClouds:
        """See `Problem.point_clouds`."""
        return PointClouds(
            source=points.source,
            target=points.target,
            source_variance=points.source_noise**2,
            target_variance=points.target_noise**2,
            scaled=self.scale == 0.0,
            mirror=self.mirror and points.source.shape[1] == 2,
            source_covariance=points.source_covariance,
            target_covariance=points.target_covariance,
        )

    def poses(self, points: PointSets, assignments: Integers) -> list[Pose | None]:
        """Motions of the source onto the target; see `Problem.poses`.

        Covariances are 6 × 6 in space and 3 × 3 in a plane, with one row and column more for an unknown scale.
        """
        return [point_set_pose(points, one, scaled=self.scale == 0.0, mirror=self.mirror) for one in assignments]

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> Floats:
        """Polynomials d x − e (E, 2) of pairs of points (E, 2, dimension)."""
        sides = [
            np.linalg.norm(points[:, 1] - points[:, 0], axis=-1)
            for points in (np.asarray(source, dtype=float), np.asarray(target, dtype=float))
        ]
        return np.stack([sides[0], -sides[1]], axis=-1)


@dataclass(frozen=True)
class Rigid(Similarity):
    """Points of a plane or of space, matched up to rotation and translation: `Similarity` with the scale known to be 1.

    Pass it to `rootmatch.match`; its methods are only needed to write problems or samplers.

    A hyper-edge of three has three constraints, the sides of a triangle. Both sets are in the same unit. Parameters and
    errors are those of `Similarity`.
    """

    name: ClassVar[str] = "rigid"
    constraints: ClassVar[int] = 3
    predicted_rows: ClassVar[int] = 6
    scale: ClassVar[float] = 1.0

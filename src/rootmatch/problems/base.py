"""The interface of every geometric problem: its sizes, its polynomial and its tables."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.unit_rays import UnitRays
from rootmatch.errors import InputError
from rootmatch.frozen import once
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.checks import MIN_NOISE, check_normals, check_points, check_view_angle
from rootmatch.problems.limits import MAX_PAIRS
from rootmatch.problems.noise import (
    add_model_noise,
    check_source_noise,
    detection_covariances,
    mean_deviation,
    parse_noise,
    split_noise,
)
from rootmatch.problems.points import CheckedSource, PointClouds, PointSets, TwoViews
from rootmatch.problems.pose_fit.pose import Pose

MAX_RADIANS = 0.5
"""Largest plausible angular noise; beyond it, pixels were probably meant. A round value."""


class Problem(ABC):
    """A minimal problem whose univariate polynomials bind correspondences together.

    A minimal set of ``minimal`` correspondences gives one polynomial of degree ``degree``; a hyper-edge of
    ``order = minimal + 1`` correspondences joins two minimal sets whose polynomials share a root when all are right.
    """

    name: ClassVar[str]
    """Short name, also on the command line."""
    minimal: ClassVar[int]
    """Correspondences of a minimal set."""
    degree: ClassVar[int]
    """Degree of the univariate polynomial."""
    constraints: ClassVar[int]
    """Independent constraints of a hyper-edge: the degrees of freedom of the ``joint`` residual."""
    source_dimension: ClassVar[int]
    """3 if the source is points in space, 2 if it is an image."""
    target_dimension: ClassVar[int] = 2
    source_is_image: ClassVar[bool] = False
    """Whether the source is a first image rather than points in space."""
    takes_normals: ClassVar[bool] = False
    """Whether source points are points in space seen by a camera, whose visible side normals can state."""
    takes_prior: ClassVar[bool] = False
    """Whether a pose of its camera can be predicted: source points in space, and ``camera``."""
    takes_motion_prior: ClassVar[bool] = False
    """Whether the motion between two sets of points in space can be predicted."""
    predicted_rows: ClassVar[int] = 6
    """Rows of the covariance of a whole predicted pose: rotation and translation in space, and the scale if unknown."""
    noisy_source: ClassVar[bool] = False
    """Whether source points carry noise of their own, as those of an image do."""
    min_for_pose: ClassVar[int] = 0
    """Minimum number of matches for `poses`; 0 if the problem fits none."""
    to_check: ClassVar[str] = "the units and the arguments of the problem"
    """What to check if no assignment can be trusted, as the advice of the status says it."""
    to_tell: ClassVar[str] = "restrict the possible pairs by `candidates`"
    """What may tell apart assignments that are equally good, for the advice. Name nothing that the problem refuses."""
    small_baseline: float = 0.0
    """ρ of a prior exp(−∣R₂ₙ,₂ₙ∣ / ρ) on each hyper-edge, for views from nearly one place; 0 for none."""
    paper_rho: ClassVar[float] = 1e-6
    """ρ of the paper's preset, as a scan chose it on noisy scenes (docs/reproduction/preset-rho-scan.csv).
    The scale of ∣R₂ₙ,₂ₙ∣ differs by problem: medians of false hyper-edges are 3e-7 (P3P), 4e-5 (3P1) and 0.5 (up2p)."""
    paper_rho_of_exact_data: ClassVar[float] = 1e-12
    """ρ of the paper's preset for exact data, whose residuals are rounding errors (the same scan)."""

    @property
    def order(self) -> int:
        """Correspondences of a hyper-edge: one more than those of a minimal set."""
        return self.minimal + 1

    @property
    def pair_count(self) -> int:
        """Pairs of minimal sets of one hyper-edge that can be compared."""
        return min(math.comb(self.minimal + 1, 2), MAX_PAIRS)

    @once
    def sensor(self) -> CameraModel | None:
        """The camera that the target is seen by; None if there is none, or it is part of a measurement."""
        camera = getattr(self, "camera2", None) or getattr(self, "camera", None)
        return camera if isinstance(camera, CameraModel) else None

    def check_source(
        self,
        source: ArrayLike,
        normals: ArrayLike | None = None,
        view_angle: ArrayLike | None = None,
        *,
        distinct: bool = True,
    ) -> CheckedSource:
        """The source, checked once for all targets; see `validated`."""
        if normals is not None:
            Capability.NORMALS.require(self.takes_normals, self.name)
        points = check_points(source, self.source_dimension, "source", self.order, distinct, of=self.name)
        facing = None if normals is None else check_normals(normals, len(points))
        return CheckedSource(points, facing, check_view_angle(view_angle, normals, len(points)))

    def validated(
        self,
        source: ArrayLike | CheckedSource,
        target: ArrayLike,
        noise: ArrayLike = 1.0,
        normals: ArrayLike | None = None,
        view_angle: ArrayLike | None = None,
        *,
        source_noise: ArrayLike | None = None,
        min_target: int | None = None,
        distinct: bool = True,
    ) -> PointSets:
        """The points, checked once for everything that follows.

        Parameters
        ----------
        source : (n, 3) or (n, 2) array
            Points in space (any unit, any frame) or pixels of the first image; or what `check_source` made of them
            and of the normals with their view angle.
        target : (n', 2) or (n', 3) array
            Pixels, or points in space.
        noise : float, (n',) array, or a pair
            Standard deviation of a coordinate of the target, in its unit (pixels of an image). Where the source is
            noisy too, one number holds for both sets, n' numbers for the target and their root mean square for the
            source; a tuple or list of two gives both, each a number or one for each point. Of points in space or of a
            plane, and of pixels if the source is in space, also σ of each axis (m, k), or covariances (m, k, k).
        normals : (n, 3) array, optional
            Outward normals of source points in space, which are visible only from their front; zero where unknown.
        view_angle : float or (n,) array, optional
            Radians from its normal within which a point is visible; the edge is soft. Default: π/2.
        source_noise : float, (n,), (n, k) or (n, k, k) array, optional
            Of the source alone, see `rootmatch.problems.noise.check_source_noise`.
        min_target : int, optional
            Least number of target points; that of a hyper-edge by default.
        distinct : bool
            Whether no two source points may be the same: those of different bodies may.

        Raises
        ------
        InputError
            If the points cannot be used; the text says why.
        """
        if not isinstance(source, CheckedSource):
            settled = self.for_points(source)
            checked = settled.check_source(source, normals, view_angle, distinct=distinct)
            return settled.validated(checked, target, noise, source_noise=source_noise, min_target=min_target)
        first, facing, cosine = source
        needing = f"{self.name} without prior=" if self.takes_prior else self.name
        minimum = min_target or self.order
        # pixels that are rounded may well be the same, and an image model weighs which of two detections is meant
        second = check_points(
            self.joined(target), self.target_dimension, "target", minimum, not self.takes_prior, of=needing
        )
        of_source = of_target = None
        if self.noisy_source and not self.source_is_image:
            noise, of_source, of_target = split_noise(noise, first, second)
        elif self.takes_prior and not self.noise_is_angular:
            of_target = detection_covariances(noise, len(second))
            noise = noise if of_target is None else mean_deviation(of_target)
        sigma, sigma2 = parse_noise(
            noise, (len(first), len(second)), self.noisy_source, self.name, self.noise_pixels(first, second)
        )
        if self.noise_is_angular and sigma2.max() > MAX_RADIANS:
            raise InputError(
                f"noise: {sigma2.max():g} given; detections are unit rays, so give it in radians, such as 0.001"
            )
        points = PointSets(
            first, second, sigma, sigma2,
            normals=facing, view_cosine=cosine, source_covariance=of_source, target_covariance=of_target,
        )  # fmt: skip
        if source_noise is None:
            return points
        if self.noisy_source and isinstance(noise, tuple | list) and len(noise) == 2 and np.any(noise[0]):
            raise InputError("source_noise: noise is a pair, which says it already; leave one of them out")
        return self.with_source_noise(points, source_noise)

    @property
    def takes_source_noise(self) -> bool:
        """Whether the points of the source may have a noise of their own."""
        return self.noisy_source or (self.takes_prior and self.sensor is not None)

    def with_source_noise(self, points: PointSets, noise: ArrayLike) -> PointSets:
        """Points with a noise of the source of its own, as `validated` takes it."""
        if self.noisy_source:
            covariance = check_source_noise(noise, points.source)
            minimum = MIN_NOISE * self.noise_pixels(points.source, points.target)[0]
            sigma = np.maximum(mean_deviation(covariance), minimum)
            alike = np.allclose(covariance, sigma[:, None, None] ** 2 * np.eye(covariance.shape[-1]))
            if not alike and self.source_is_image:
                raise InputError(f"source_noise: {self.name} takes one σ for both axes; give a number or one a point")
            return replace(points, source_noise=sigma, source_covariance=None if alike else covariance)
        if not self.takes_source_noise:
            raise InputError(f"source_noise: {self.name} has exact source points; leave it out")
        covariance = check_source_noise(noise, points.source)
        return self.in_image(replace(points, source_covariance=covariance)) if covariance.any() else points

    def in_image(self, points: PointSets) -> PointSets:
        """Points whose detections have the noise of the source in theirs, as far as that shows in the image."""
        return points if self.noisy_source or self.sensor is None else add_model_noise(points, self.sensor)

    def with_noise(self, points: PointSets, sigma: float) -> PointSets:
        """Points with one σ of a coordinate for that of all, without the noise that is stated of a measured model."""
        pixels = self.noise_pixels(points.source, points.target)
        of_source, of_target = parse_noise(sigma, points.shape, self.noisy_source, self.name, pixels)
        return self.in_image(replace(points, source_noise=of_source, target_noise=of_target, noise_alone=None))

    def joined(self, target: ArrayLike) -> ArrayLike:
        """Detections as rows of one array: those of a rig in any form that `Rig` takes."""
        return target if self.rig is None else self.rig.joined(target)

    @once
    def rig(self) -> Rig | None:
        """The rig whose cameras see the target; None if it is one camera, or there is none."""
        camera = getattr(self, "camera", None)
        return camera if isinstance(camera, Rig) else None

    @once
    def is_uncertain(self) -> bool:
        """Whether the calibration of a camera is stated not to be exact."""
        return any(getattr(getattr(self, name, None), "is_uncertain", False) for name in ("camera", "camera2"))

    @once
    def noise_is_angular(self) -> bool:
        """Whether the noise is in radians: detections are unit rays."""
        return isinstance(self.sensor, UnitRays)

    def noise_pixels(self, source: NDArray[np.float64], target: NDArray[np.float64]) -> tuple[float, float]:
        """Length that counts as a pixel of either set when noise is compared with one; see `checks.MIN_NOISE`."""
        return 1.0, 1.0

    def image(self, points: PointSets) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Target points in the plane of the pose fits, (n', 2), and their noise there: the pixels themselves.

        Unit rays are mapped to a plane (`rootmatch.cameras.base.CameraModel.chart`).
        """
        if self.sensor is None:
            return points.target, points.target_noise
        return self.sensor.chart(points.target, points.target_noise)[1:]

    def _take_dimensions(self, camera: CameraModel, camera2: CameraModel | None = None) -> None:
        """The numbers of a point are those of its camera's detections: in the image, or in both images."""
        if self.source_is_image:
            self.__dict__.update(source_dimension=camera.dimension)
        self.__dict__.update(target_dimension=(camera2 or camera).dimension)

    def for_points(self, source: ArrayLike) -> Problem:
        """The problem with what it left open, such as the dimension of `Similarity`, settled by the source points.

        Raises
        ------
        InputError
            If the points do not settle it.
        """
        return self

    def prepare(
        self, source: ArrayLike, target: ArrayLike, noise: ArrayLike = 1.0, normals: ArrayLike | None = None
    ) -> Any:
        """Tables for the kernels of points as they are given; see `validated` and `tables`."""
        settled = self.for_points(source)
        return settled.tables(settled.validated(source, target, noise, normals))

    @abstractmethod
    def tables(self, points: PointSets) -> Any:
        """Tables for the kernels: a NamedTuple of arrays that knows them (`rootmatch.problems.kernels`).

        Raises
        ------
        InputError
            If the points are degenerate; the text says why.
        """

    @abstractmethod
    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """Polynomials (E, degree + 1), highest degree first, of minimal sets: (E, m, 3|2) and (E, m, 2) points.

        Their scale means nothing: the residuals of the paper take them with unit Euclidean norm.
        """

    def point_clouds(self, points: PointSets) -> PointClouds | None:
        """Both point sets, as the search for the motion between them takes them; None if they are not of one space."""
        return None

    def two_views(self, points: PointSets) -> TwoViews | None:
        """Both images, as the search for their relative pose takes them; None if it cannot search."""
        return None

    def at_focal_lengths(self, points: PointSets) -> Callable[[], list[Any]] | None:
        """What makes tables for the kernels of a known camera at some focal lengths; None where that is no unknown."""
        return None

    def without_vertical(self, points: PointSets) -> Callable[[], Any] | None:
        """What makes tables of minimal sets of one point more, which need no vertical; None where none is measured."""
        return None

    def poses(self, points: PointSets, assignments: NDArray[np.int64]) -> list[Pose | None]:
        """The most likely pose of each assignment (K, n), with its covariance; None if none is possible.

        Each assignment needs `min_for_pose` matches.
        """
        raise NotImplementedError(f"{self.name} fits no poses")

    def groups(self, points: PointSets, allowed: NDArray[np.bool_] | None) -> Groups | None:
        """Fits of groups of the points by one motion each; None if the problem has none."""
        return None


class Groups(Protocol):
    """Fits of whole groups by one motion each. Groups (G, n) hold the image of each point, −1 outside of the group."""

    def chi2(self, groups: NDArray[np.int64]) -> NDArray[np.float64]:
        """χ² (G,) of all points of each group about their best common motion.

        Of m points ``2 (m − minimal)`` degrees of freedom are left.
        """
        ...

    def grown(self, groups: NDArray[np.int64]) -> NDArray[np.int64]:
        """Groups (G, n) with what their common motion predicts."""
        ...

    def extended(self, groups: NDArray[np.int64]) -> NDArray[np.int64]:
        """Groups (E, n), each with one of the correspondences more that it may predict."""
        ...

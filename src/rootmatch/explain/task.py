"""The matching task: the caller's arguments, validated once and passed from stage to stage."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.cameras.rig import Rig
from rootmatch.cameras.rig_image import RigImage
from rootmatch.deadline import NEVER, Deadline
from rootmatch.errors import InputError
from rootmatch.explain.body_labels import BodyLabels, Label, check_bodies
from rootmatch.explain.match_options import MatchOptions
from rootmatch.explain.prior_validation import NONE, Prior, Rivals, check_predicted, prior_attributes
from rootmatch.explain.validation import (
    allow_for_calibration,
    check_not_exact,
    check_problem,
    join_camera_noise,
    split_candidates,
)
from rootmatch.frozen import copy_with, once
from rootmatch.hypergraph.affinity import Affinity
from rootmatch.hypergraph.enumeration import farthest_point_order
from rootmatch.problems.base import Problem
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.p3p import P3P
from rootmatch.problems.points import CheckedSource, PointSets
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_prior import PosePrior
from rootmatch.problems.pose_fit.rig_fit import list_sightings
from rootmatch.problems.residual_dispatch import residual_kinds_of_tables
from rootmatch.samplers.base import SampledTensor, SamplingTask

EXACT = 0.01
"""σ of a coordinate in pixels up to which data count as exact: residuals then come from rounding, not from noise."""
EXACT_RADIANS = 1e-5
"""σ in radians up to which unit rays count as exact: `EXACT` pixels at a focal length of 1000."""
SAMPLED, RESERVE = 0.7, 0.5
"""Share of the time left at a deadline that sampling may take, and seconds that always suffice for the rest."""


@dataclass(frozen=True, eq=False)
class MatchingTask:
    """Points, problem and options, validated.

    Detections of a rig have a camera each, and an assignment has a row for each sighting: every point in every camera.
    """

    problem: Problem
    points: PointSets
    """Source and target with their noise and normals."""
    affinity: Affinity
    """From a hyper-edge's residual to its weight."""
    options: MatchOptions = field(default_factory=MatchOptions)
    noise: Any = 1.0
    """Standard deviation as it was given, or as it was estimated."""
    estimates_noise: bool = False
    noise_is_estimated: bool = False
    """Whether the noise is to be estimated, that of ``points`` is meaningless then; and whether it has been."""
    allowed: NDArray[np.bool_] | None = None
    """(n, n') correspondences that are possible."""
    weights: NDArray[np.float64] | None = None
    """(n, n') prior weights of correspondences."""
    bodies: BodyLabels | None = None
    """Which rigid body each source point belongs to, where there are several."""
    prior_pose: Pose | None = None
    """A predicted pose with its covariance."""
    rivals: Rivals = NONE
    """Of ``prior_pose``."""
    priors: dict[Label, Prior] = field(default_factory=dict)
    rivals_of: dict[Label, Rivals] = field(default_factory=dict)
    """What is known of the poses of several bodies, by label, and what else those may be."""
    prior_freedom: float = math.inf
    """Degrees of freedom of the predictions' covariances; see `rootmatch.model.pose_density.Gaussian`."""
    present: float | None = None
    present_of: dict[Label, float] = field(default_factory=dict)
    """Probability that the body, or each of several, is in space, or what two views show; by default the model's."""
    calibration_noise: NDArray[np.float64] | None = None
    """Part (n',) of the detections' noise that stands for errors of the calibration; None if that is exact."""
    weighs_parts: bool = True
    """Whether a confidence in unmatched points allows for what is in view and shows too little to be recognised."""
    log_inexact: tuple[float, ...] = ()
    """Log-odds by earlier frames that points are off by each of the first `rootmatch.model.image_alike.ERRORS`."""
    known: PosePrior | None = None
    """Partial knowledge of the pose."""
    budget: int | None = None
    """Evaluations of a guided search that a tracker or the search for several bodies bounds."""
    search_camera: int | None = None
    """The only camera of a rig in which minimal sets are searched."""
    found_before: NDArray[np.int64] | None = None
    """(K, n) assignments that a guided search begins with."""
    kept_searches: list[tuple[MatchingTask, SampledTensor]] | None = None
    """What `rootmatch.explain.sampling` keeps while variants of the task are tried."""
    more_images: bool = False
    """Whether images of the same points follow, so that what all of them need is prepared at once."""
    deadline: Deadline = NEVER
    """When every stage hands on what it has found."""

    @classmethod
    def of(
        cls,
        problem: Problem,
        source: ArrayLike | CheckedSource,
        target: ArrayLike,
        *,
        noise: ArrayLike | Literal["auto"] = 1.0,
        normals: ArrayLike | None = None,
        view_angle: ArrayLike | None = None,
        candidates: ArrayLike | None = None,
        bodies: ArrayLike | BodyLabels | None = None,
        prior: Prior | Mapping[Label, Prior] | None = None,
        source_noise: ArrayLike | None = None,
        options: MatchOptions | None = None,
        **told: Any,
    ) -> Self:
        """The task of arguments as `rootmatch.match` takes them; ``bodies`` may be checked already.

        ``told``: the deadline, and what else a tracker knows, by the names of the attributes. A source that is checked
        already is that of a matcher, which has checked its problem and the priors of its frames as well.
        Raises `InputError` if the input cannot be used; the text says what to do.
        """
        if not isinstance(source, CheckedSource):
            check_problem(problem)
            problem = problem.for_points(source)
        options = options or MatchOptions()
        if problem.rig is not None:
            options.check_rig()
        if options.resolution is not None:
            has_pixels = hasattr(problem, "camera") and not problem.noise_is_angular
            Capability.RESOLUTION.require(problem.takes_prior and has_pixels, problem.name)
        if estimates := isinstance(noise, str):
            if noise != "auto":
                raise InputError(f"noise: {noise!r} given; expected a number or 'auto'")
            if source_noise is not None and problem.noisy_source:
                raise InputError('noise: "auto" and source_noise= cannot be combined for point sets; give a number')
            noise = 0.0  # until it is estimated
        else:
            check_not_exact(noise := join_camera_noise(problem.rig, noise, target))
        minimum = 1 if prior is not None and problem.takes_prior else None
        points = problem.validated(
            source, target, noise, normals, view_angle,
            source_noise=source_noise, min_target=minimum, distinct=bodies is None,
        )  # fmt: skip
        points, of_calibration = allow_for_calibration(problem, points)
        pixel = problem.noise_pixels(points.source, points.target)[1]
        exact = EXACT_RADIANS if problem.noise_is_angular else EXACT * pixel
        weigh = options.affinity(problem, not estimates and bool(points.target_noise.max() <= exact))
        allowed, weights = split_candidates(candidates, *points.shape)
        labels = bodies if isinstance(bodies, BodyLabels | None) else check_bodies(bodies, points.source, problem.order)
        if prior is not None and not isinstance(source, CheckedSource):
            problem, prior = check_predicted(prior, labels, problem)
        if labels is not None and (options.motions != 1 or estimates):
            raise InputError(
                "motions: bodies= already says which points move together; leave motions out"
                if options.motions != 1
                else 'noise: "auto" cannot be estimated from several bodies; give a number of pixels'
            )
        return cls(
            problem=problem, points=points, affinity=weigh, options=options, noise=noise, estimates_noise=estimates,
            allowed=allowed, weights=weights, bodies=labels, calibration_noise=of_calibration,
            **prior_attributes(prior), **told,
        )  # fmt: skip

    @once
    def shape(self) -> tuple[int, int]:
        """Number of source and target points, (n, n')."""
        return self.points.shape

    @once
    def rig(self) -> Rig | None:
        """The rig of cameras that see the target; None for one camera, or none."""
        return self.problem.rig

    @property
    def minimal(self) -> int:
        """Matches in one image that always have a pose: a minimal set; a rig is searched by those of `P3P`."""
        return self.problem.minimal if self.rig is None else P3P.minimal

    @once
    def rows(self) -> int:
        """Rows of an assignment: points or, of a rig, their sightings in all cameras."""
        return self.shape[0] * (1 if self.rig is None else len(self.rig.views))

    @property
    def row_shape(self) -> tuple[int, int]:
        """Numbers of an assignment's rows and of target points."""
        return self.rows, self.shape[1]

    @once
    def camera_of(self) -> NDArray[np.int64]:
        """Camera (n',) of each detection; 0 without a rig."""
        target = self.points.target
        return np.zeros(len(target), np.int64) if self.rig is None else np.asarray(target[:, 2].astype(np.int64))

    @once
    def sightings(self) -> tuple[RigImage, PointSets]:
        """The images of a rig in one plane, and its sightings; see `list_sightings`."""
        assert self.rig is not None
        return list_sightings(self.rig, self.points)

    @once
    def row_weights(self) -> NDArray[np.float64] | None:
        """Prior weights of each row of an assignment and each detection, (rows, n')."""
        return None if self.weights is None else np.tile(self.weights, (self.rows // self.shape[0], 1))

    @once
    def log_weights(self) -> NDArray[np.float64] | None:
        """Log-odds (rows, n') of the candidates by their weights, see `candidate_log_odds`; None without weights."""
        if self.weights is None or self.row_weights is None:
            return None
        return candidate_log_odds(self.row_weights, None if self.rig is None else self.own_camera)

    @once
    def own_camera(self) -> NDArray[np.bool_]:
        """Which detections are of the camera of each row of an assignment, (rows, n')."""
        return np.asarray(np.arange(self.rows)[:, None] // self.shape[0] == self.camera_of)

    def sighting_rows(self, points: NDArray[np.int64]) -> NDArray[np.int64]:
        """Rows (…, C m) of an assignment for points (…, m), those of the first camera first; −1 for a point −1."""
        if self.rig is None:
            return points
        first, each = np.arange(0, self.rows, self.shape[0])[:, None], points[..., None, :]
        return np.where(each >= 0, first + each, -1).reshape(*points.shape[:-1], len(first) * points.shape[-1])

    @property
    def has_prior(self) -> bool:
        """Whether anything is known of the pose, or of that of any body."""
        return self.prior_pose is not None or self.known is not None or bool(self.priors)

    @property
    def is_predicted(self) -> bool:
        """Whether a pose is predicted, of any body."""
        return self.prior_pose is not None or any(isinstance(one, Pose) for one in self.priors.values())

    def without_priors(self) -> Self:
        """A copy of the task without any knowledge of poses."""
        return copy_with(self, rivals=NONE, rivals_of={}, **prior_attributes(None))

    @once
    def image(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Target points (n', 2) in the plane in which poses are fitted, pixels as a rule, and their σ (n',) there."""
        return self.problem.image(self.points)

    @once
    def permutation(self) -> NDArray[np.int64]:
        """Source points in the order in which kernels get them, (n,): points far apart first.

        The order decides which resultant a hyper-edge has, unless it is drawn in an order of its own. The paper does
        not choose one, so its preset takes the points as given, unless it searches.
        """
        if self.options.is_paper and self.options.chosen_sampler in ("random", "exhaustive"):
            return np.arange(self.shape[0])
        return farthest_point_order(self.points.source)

    @once
    def ordered_points(self) -> PointSets:
        """The points with the source in `permutation`."""
        return self.points.subset(source=self.permutation)

    @once
    def tables(self) -> Any:
        """Tables for the kernels, the source points in `permutation`."""
        return self.problem.tables(self.ordered_points)

    @once
    def sampling_task(self) -> SamplingTask:
        """What a sampler is given, the source points in `permutation`."""
        kind = self.affinity.residual.kernel_kind(self.problem.pair_count)
        Capability.RESIDUAL.require(type(kind) in residual_kinds_of_tables(self.tables), self.problem.name)
        return SamplingTask(
            problem=self.problem.name, tables=self.tables,
            kind=kind, affinity=self.affinity,
            shape=self.shape, order=self.problem.order, seed=self.options.seed, motions=self.options.motions,
            candidates=None if self.allowed is None else self.allowed[self.permutation],
            progress=self.options.progress,
            view_cosine=self.ordered_points.view_cosine,
            deadline=self.deadline.part(SAMPLED, RESERVE),
            clouds=self.problem.point_clouds(self.ordered_points), views=self.problem.two_views(self.ordered_points),
            at_focal_lengths=self.problem.at_focal_lengths(self.ordered_points),
            without_vertical=self.problem.without_vertical(self.ordered_points),
            more_images=self.more_images,
            found_before=None if self.found_before is None else self.found_before[:, self.permutation],
        )  # fmt: skip

    def with_noise(self, sigma: float) -> Self:
        """A copy of the task with an estimate of the noise of all points, that of a measured model aside."""
        points = self.problem.with_noise(self.points, sigma)
        return copy_with(self, points=points, noise=sigma, estimates_noise=False, noise_is_estimated=True)

    @cached_property
    def each_body(self) -> list[Self]:
        """The tasks of the bodies among all detections, with their predicted poses; itself where none are labelled."""
        if self.bodies is None:
            return [self]
        every = []
        for k, (name, points) in enumerate(zip(self.bodies.names, self.bodies.parts_of(self.points), strict=True)):
            told = prior_attributes(self.priors.get(name)) | {"present": self.present_of.get(name)}
            told["rivals"] = self.rivals_of.get(name, NONE)
            every.append(self.subset(self.bodies.points_of(k), None, points=points, **told))
        return every

    def subset(self, source: NDArray[np.int64] | None, target: NDArray[np.int64] | None, **known: Any) -> Self:
        """The task of some of the points, None for all, in this process, without a predicted pose unless ``known``.

        Partial knowledge of the pose holds for some of the points as well.
        """
        told: dict[str, Any] = {"prior_pose": None, "rivals": NONE, "found_before": None, "priors": {}, "rivals_of": {}}
        told |= {"bodies": None, "options": self.options.local_options} | known
        rows, columns = (slice(None) if one is None else one for one in (source, target))
        points = told.pop("points", None) or self.points.subset(source, target)

        def of_pairs(whole: NDArray[Any] | None) -> NDArray[Any] | None:
            return None if whole is None else np.ascontiguousarray(whole[rows][:, columns])

        return copy_with(
            self,
            points=self.problem.in_image(points),
            calibration_noise=None if self.calibration_noise is None else self.calibration_noise[columns],
            allowed=of_pairs(self.allowed),
            weights=of_pairs(self.weights),
            **told,
        )


def candidate_log_odds(weights: NDArray[np.float64], among: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
    """Logarithms (n, n') of the weights of candidates over their mean in each row; −∞ where one is zero.

    A row tells which of its candidates is the detection of a point, if it has one: the weight of each over their sum
    stands in the place of one over their number. So only ratios within a row count, as those of likelihoods do. The
    factor of a clutter point is 1 in the mean: weights that know nothing make no pose more probable than clutter.

    ``among``: (n, n') which pairs may be, of a rig those of a sighting's own camera.
    """
    possible = weights > 0.0 if among is None else among & (weights > 0.0)
    mean = np.where(possible, weights, 0.0).sum(axis=1) / np.maximum(possible.sum(axis=1), 1)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(weights) - np.log(np.where(mean > 0.0, mean, 1.0))[:, None])

"""The image of a body: what is known of its points, of the detections, of clutter, and where a pose puts the points.

Point i is visible in pose T with v_i(T), a visible point is detected with rate δ, at y ~ N(π(T X_i), S_j + J Σ_i Jᵀ).
All other detections are clutter, a Poisson process whose density about each detection is estimated from the image
(`rootmatch.model.clutter`). What is not known exactly is integrated out: δ under a Beta distribution, a factor on all
variances under an inverse gamma distribution, the number of clutter points under Jeffreys' prior.

A rig of cameras uses the same model: its points are sightings, camera by camera, and its camera model projects each by
its own camera (`rootmatch.cameras.rig_image.RigImage`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.cameras.base import CameraModel
from rootmatch.frozen import once
from rootmatch.model.blobs import average_blobs, blob_variance_of, find_blobs
from rootmatch.model.clutter import Clutter, clutter_areas, estimate_clutter
from rootmatch.model.compiled.evidence import fill_visibility
from rootmatch.model.linearised import Linearised, linearise_body
from rootmatch.model.pose_density import Broad, PoseDensity
from rootmatch.model.priors import NOISE_FREEDOM, beta_quadrature
from rootmatch.model.views import Views, kernel_camera_views, unproject_detections
from rootmatch.model.visibility import BARELY, UNSEEN
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import centre_points, pose_about_point

ANY_POSE = Broad()
NONE, NO_ROWS = np.empty(0), np.empty((0, 0))
"""What a kernel gets in the place of None."""
ISOTROPIC = np.empty((0, 2, 2))
"""What covariances of detections have beyond their σ, as a kernel takes it: nothing."""
HIGHEST_RATE = 0.999
"""Highest detection rate that is believed: beyond it, one hidden point would refute a pose."""
USUAL_RATE = 0.9
"""Detection rate assumed if none is given, where it is not integrated over."""
RATE_PRIOR, RATE_PRIOR_WITHOUT_NORMALS = (9.0, 1.0), (1.0, 1.0)
"""Beta distributions of the rate at which a visible point is detected: nine in ten if normals tell which are visible;
without them it also covers how much of the body hides the rest. Their effects are measured in docs/model.md."""
MORE_SIGHTINGS = 2
"""Sightings by other cameras beside a minimal set in one, at least: with one, hundreds of false sets have as many."""


@dataclass(frozen=True, eq=False)
class DetectionModel:
    """A body and its image.

    Parameters
    ----------
    camera : CameraModel
        Whose detections are points of a plane (`CameraModel.chart`).
    points : (n, 3) array
        Of the body, in the caller's unit.
    target : (n', 2) array
        Detections, px.
    sigma : (n',) array
        Their standard deviations.
    normals : (n, 3) array, optional
        Outward; zero where unknown.
    view_cosine : (n,) array, optional
        Cosines of the view angles.
    source_covariance : (n, 3, 3) array, optional
        Of the model points, in the caller's unit squared.
    target_covariance : (n', 2, 2) array, optional
        Of the detections, px², if their noise differs by axis; ``sigma`` is then the root mean square of both axes.
    calibration_noise : (n',) array, optional
        Part of ``sigma`` that stands for errors of the calibration, px.
    rate : float, optional
        Rate at which a visible point is detected; integrated over if not given.
    prior : PoseDensity
        Prior of the pose; a broad one if not given.
    allowed : (n, n') bool array, optional
        Possible correspondences.
    log_weights : (n, n') array, optional
        Logarithm of the weight of each correspondence, over its mean for a point's detections.
    resolution : float
        Distance in px below which two points are one detection.
    noise_freedom : float
        See `NOISE_FREEDOM`.
    """

    camera: CameraModel
    points: Floats
    target: Floats
    sigma: Floats
    normals: Floats | None = None
    view_cosine: Floats | None = None
    source_covariance: Floats | None = None
    target_covariance: Floats | None = None
    calibration_noise: Floats | None = None
    rate: float | None = None
    prior: PoseDensity = ANY_POSE
    allowed: NDArray[np.bool_] | None = None
    log_weights: Floats | None = None
    resolution: float = 0.0
    noise_freedom: float = NOISE_FREEDOM

    @once
    def shape(self) -> tuple[int, int]:
        """Number of points and detections, (n, n')."""
        return len(self.points), len(self.target)

    @once
    def centre(self) -> Floats:
        """Mean (3,) of the points, to which positions refer and about which rotations turn."""
        return self._centre_and_radius[0]

    @property
    def radius(self) -> float:
        """Root mean square distance of the points from it."""
        return self._centre_and_radius[2]

    @once
    def _centre_and_radius(self) -> tuple[Floats, Floats, float]:
        return centre_points(self.points)

    @once
    def images(self) -> list[Integers]:
        """Detections of each of several images, none for one."""
        return self.camera.images()

    @once
    def areas(self) -> Floats:
        """Area (C,) in px² of each image in which clutter may lie, as the camera knows it, or by the detections."""
        known = self.camera.image_areas(self.target)
        return clutter_areas(self.target, self.sigma, self.images, self.camera.focal) if known is None else known

    @once
    def clutter(self) -> Clutter:
        """Distribution of clutter in the image."""
        return estimate_clutter(self.target, self.sigma, self.areas, self.image_indices)

    @once
    def image_indices(self) -> Integers:
        """Image that each detection (n',) lies in; 0 if there is only one."""
        out = np.zeros(self.shape[1], np.int64)
        for k, own in enumerate(self.images):
            out[own] = k
        return out

    def is_searchable(self, assignment: Integers, minimal: int, points: int = 0, *, triples: int = 0) -> bool:
        """Whether a search meets poses with as many matches as an assignment (n,) has in each image.

        It needs more than a minimal set in one image; where normals tell what several cameras see, or the triples of
        an image are no more than so many ``triples``, a minimal set in one and more in others, in all of so many
        ``points`` at least.
        """
        used = assignment >= 0
        counts = np.bincount(self.image_indices[assignment[used]])
        maximum = int(counts.max(initial=0))
        if maximum != minimal or len(self.images) < 2:
            return maximum > minimal
        if self.normals is None:
            shown = np.bincount(self.image_indices)[np.flatnonzero(counts == maximum)]
            if count_triples(len(self.points) // len(self.images), int(shown.min())) > triples:
                return False
        distinct = np.count_nonzero(used.reshape(len(self.images), -1).any(axis=0))
        return bool(distinct >= points and np.count_nonzero(used) >= minimal + MORE_SIGHTINGS)

    @once
    def rays(self) -> Floats:
        """Unit rays (n', 3) of the detections in the frames of their cameras."""
        return unproject_detections(self.camera, self.target)

    @once
    def _log_counts(self) -> Floats:
        """Logarithm (C, n' + 1) of the odds of 0, 1, 2 … clutter points fewer than each image has detections.

        By Jeffreys' prior of the rate in each.
        """
        counts = np.bincount(self.image_indices, minlength=max(len(self.images), 1))
        return log_count_odds(tuple(counts.tolist()), self.shape[1]).copy()

    def log_odds_of_left(self, taken: NDArray[np.bool_]) -> Floats:
        """Logarithm (K,) of the odds of as many clutter points as detections (K, n') that are taken leave."""
        matches = (taken.astype(np.float32) @ self._in_each_image).astype(np.int64)
        return np.asarray(self._log_counts[np.arange(matches.shape[1]), matches].sum(axis=1))

    @once
    def _in_each_image(self) -> NDArray[np.float32]:
        """Which detections are in each image (n', C), as floats."""
        return np.asarray(self.image_indices[:, None] == np.arange(len(self._log_counts)), np.float32)

    @once
    def rate_quadrature(self) -> tuple[Floats, Floats]:
        """Nodes (Q,) and logarithms of weights of the integral over the detection rate."""
        if self.rate is not None:
            return np.array([min(self.rate, HIGHEST_RATE)]), np.zeros(1)
        known = self.normals is not None
        first, second = RATE_PRIOR if known else RATE_PRIOR_WITHOUT_NORMALS
        return beta_quadrature(first, second)

    def centred(self, rotation: ArrayLike, translation: ArrayLike) -> tuple[Floats, Floats]:
        """Rotations (K, 3, 3) and positions (K, 3) of the body's centre, of poses x = R X + t."""
        R, t = np.asarray(rotation, dtype=float), np.asarray(translation, dtype=float)
        return R, t + R @ self.centre

    def pose_of_origin(self, rotation: Floats, position: Floats, covariance: Floats) -> Pose:
        """A pose (3, 3) and (3,) of the body's centre with its covariance (6, 6), of the points as they were given."""
        return Pose.unchecked(rotation, *pose_about_point(rotation, position, covariance, -self.centre))

    def linearise_about(self, rotation: Floats, position: Floats) -> Linearised:
        """Images of the points in poses (K, 3, 3) with the body's centre at (K, 3), to first order."""
        at = linearise_body(self.centred_body, self.camera, self._views, rotation, position)
        return at if self.resolution == 0.0 else self._merge_blobs(at)

    @once
    def _views(self) -> Views | None:
        """The camera as the compiled projection takes it."""
        return kernel_camera_views(self.camera)

    @once
    def centred_body(self) -> tuple[Floats, Floats]:
        """Points (n, 3) about the centre, and normals (n, 3) or (0, 3)."""
        kept, centred, _ = self._centre_and_radius
        centred = centred if self.centre is kept else self.points - self.centre
        return centred, np.empty((0, 3)) if self.normals is None else np.array(self.normals, float)

    def _merge_blobs(self, at: Linearised) -> Linearised:
        """The same poses with points in blobs that the detector does not resolve."""
        shown = self.visibility(at, np.zeros(len(at.seen)))
        blob = find_blobs(at.pixels, shown > BARELY, self.resolution)
        if blob is None:
            return at
        lit = self.lit(shown)
        pixels, jacobian = average_blobs(blob, at.pixels, lit), average_blobs(blob, at.jacobian, lit)
        spread = blob_variance_of(blob, at.pixels, lit)
        return at._replace(pixels=pixels, jacobian=jacobian, blob=blob, blob_variance=spread)

    def lit(self, visible: Floats) -> Floats:
        """Chance (K, n) that a point of a visibility is part of its blob."""
        return np.maximum((self.rate or USUAL_RATE) * visible, UNSEEN)

    def noise_of(self, at: Linearised, image: Integers) -> Floats:
        """Standard deviations (K, n) of detections (K, n) as those of the points, px."""
        sigma = self.sigma[image]
        return sigma if at.blob_variance is None else np.asarray(np.sqrt(sigma**2 + at.blob_variance))

    @once
    def gating_image(self) -> tuple[Floats, ...]:
        """What `rootmatch.model.compiled.gating.gate` takes of the image: with covariances, σ on each axis at least."""
        (target, sigma, weights, *_), blur = self.image_for_kernels, ISOTROPIC
        if self.target_covariance is not None:
            minimum = np.linalg.eigvalsh(self.target_covariance)[:, 0]
            sigma, blur = np.sqrt(minimum), self.target_covariance - minimum[:, None, None] * np.eye(2)
        return target, sigma, blur, self.clutter.log_density, weights

    @once
    def log_areas(self) -> Floats:
        """Logarithm (n',) of 2π √|S_j| of the detections, px²."""
        if self.target_covariance is None:
            return np.asarray(np.log(2.0 * np.pi * self.sigma**2))
        return np.asarray(np.log(2.0 * np.pi) + 0.5 * np.linalg.slogdet(self.target_covariance)[1])

    @property
    def has_covariances(self) -> bool:
        """Whether what is detected differs from its prediction by more than one σ of each detection says."""
        return self.source_covariance is not None or self.target_covariance is not None

    def assigned_covariances(self, at: Linearised, image: Integers) -> Floats:
        """Covariances (K, n, 2, 2) of detections (K, n) as those of the points, px²."""
        if self.target_covariance is None:
            return np.asarray(self.noise_of(at, image)[..., None, None] ** 2 * np.eye(2))
        own = self.target_covariance[image]
        return own if at.blob_variance is None else own + at.blob_variance[..., None, None] * np.eye(2)

    def of_points(self, at: Linearised) -> Floats:
        """Covariances (K, n, 2, 2) of the pixels by those of the model points and in blobs; (K, 0, 2, 2) if exact."""
        blobs = None if at.blob_variance is None else at.blob_variance[..., None, None] * np.eye(2)
        if self.source_covariance is None:
            return np.empty((len(at.seen), 0, 2, 2)) if blobs is None else blobs
        by_point = at.by_position @ at.rotation[:, None]
        of_points = by_point @ self.source_covariance @ by_point.swapaxes(-1, -2)
        return of_points if blobs is None else of_points + blobs

    def visibility(self, at: Linearised, tilt: Floats) -> Floats:
        """Visibility (K, n), 0 to 1, of each point in each pose; ``tilt`` (K,): its direction's deviation, rad."""
        shown = np.empty(at.seen.shape)
        cosine, blob, _ = at.for_kernels
        fill_visibility((at.expected, cosine, blob), self._view_cosine, np.ascontiguousarray(tilt, np.float64), shown)
        return shown

    @once
    def _view_cosine(self) -> Floats:
        """Cosines of the view angles (n,), as kernels take them: none if unknown."""
        return NONE if self.view_cosine is None else np.array(self.view_cosine, float)

    @once
    def weights_of_pairs(self) -> Floats:
        """Logarithm (n, n') of the prior weight of each match, −∞ where it is not allowed; none if all are alike."""
        if self.log_weights is None and self.allowed is None:
            return NO_ROWS
        weights = np.zeros(self.shape) if self.log_weights is None else self.log_weights
        return np.array(weights if self.allowed is None else np.where(self.allowed, weights, -np.inf))

    @once
    def scene_for_kernels(self) -> tuple[Any, ...] | None:
        """What `rootmatch.model.compiled.settling.settle_hypotheses` takes; None where NumPy has a part in it."""
        if self._views is None or self.resolution:
            return None
        clutter, rates = self.clutter.for_kernels, (*self.rate_quadrature, self.noise_freedom)
        return self.centred_body, self._views, self.image_for_kernels, clutter, rates

    @property
    def exact_scene_for_kernels(self) -> tuple[Any, ...] | None:
        """The same for kernels that know of no covariances: None where there are some."""
        return None if self.has_covariances else self.scene_for_kernels

    @once
    def spread_for_kernels(self) -> tuple[Floats, Floats]:
        """Covariances of points (n, 3, 3) and detections (n', 2, 2) as kernels take them: none if not given."""
        points, detections = self.source_covariance, self.target_covariance
        of_points = np.empty((0, 3, 3)) if points is None else np.array(points, float)
        return of_points, np.empty((0, 2, 2)) if detections is None else np.array(detections, float)

    @once
    def alike(self) -> dict[tuple[Any, ...], Any]:
        """What `rootmatch.model.image_alike` and others told of modes, see `cache_answer` there."""
        return {}

    @once
    def image_for_kernels(self) -> tuple[Any, ...]:
        """Detections and what is known of them, as `rootmatch.model.compiled.evidence.weigh` takes it."""
        # copies: what is read-only is another type to a kernel, which would be compiled once more
        target, sigma = np.array(self.target, float), np.array(self.sigma, float)
        return target, sigma, self.weights_of_pairs, self._view_cosine, self._log_counts, self.image_indices


def count_triples(n: int, n_target: int) -> int:
    """How many matches of three of n points with three of n' detections there are."""
    return math.comb(n, 3) * math.perm(n_target, 3)


@lru_cache(maxsize=256)
def log_count_odds(counts: tuple[int, ...], maximum: int) -> Floats:
    """Logarithm (C, most + 1) of the odds of 0, 1, 2 … clutter points fewer than images have detections (C,)."""
    every = np.array([[math.lgamma(max(count - k, 0) + 0.5) for k in range(maximum + 1)] for count in counts])
    return np.asarray(every - every[:, :1])

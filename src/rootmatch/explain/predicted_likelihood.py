"""One frame and a predicted pose of its camera: projections with their covariance, assignments, fits, evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import one_rotation_matrix, one_rotation_vector
from rootmatch.cameras.base import CameraModel
from rootmatch.deadline import checkpoint
from rootmatch.explain.detection_odds import DEFAULT_OPTIONS, HALF, candidate_log_odds
from rootmatch.explain.image_density import crowded_density, squared_deviations
from rootmatch.explain.projected import Projected
from rootmatch.explain.task import MatchingTask
from rootmatch.model.clutter import clutter_areas
from rootmatch.model.detection_model import HIGHEST_RATE
from rootmatch.model.visibility import BARELY, FULLY
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.samplers.clutter import CROWDING

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

EXACT = 1e-12
"""Least eigenvalue of a prior's correlations: a parameter that is known exactly gets this instead of zero."""
STEPS = 8
"""Largest number of steps of a fit; two or three are usual from a prediction."""
SETTLED = 1e-4
"""Fall of χ² over 1 + χ², expected or seen, that ends a fit: the step before it was 0.01 σ, and the next would be its
square."""
LEAST_DAMPING = 1e-3
"""Damping of the first step after one that went too far, relative to the normal matrix's diagonal."""
ROWS = 256
"""Predictions that are compared with all detections together."""
VIEW_EDGE = 0.1
"""Width of the edge of a given view angle, in cosines, over which a point fades: poses and normals are not exact. Five
degrees at 70°. A round value."""
EDGE = 4.0
"""Widening of the edge of a view angle, in standard deviations of the camera's direction: two on each side."""
VAGUE_ANGLE, VAGUE_LENGTH = 3.0, 10.0
"""Standard deviations of a prior that says nothing: radians, and lengths over the distance."""
USUAL_DETECTION = 0.9
"""Detection rate assumed before there is an assignment to estimate it from."""


@dataclass(frozen=True, eq=False)
class PriorFit:
    """An assignment fitted with the prior."""

    assignment: Integers
    R: Floats
    t: Floats
    covariance: Floats
    at: Projected
    chi2: float
    """Of the detections about the pose."""
    chi2_prior: float
    """Of the pose about the prior."""
    dof: int
    """Degrees of freedom of their sum: two for each match, as the prior pays for the pose."""
    expected: float
    """Visible points."""
    log_odds: float
    """Against clutter alone, the pose integrated out."""
    visibility: float
    """Part of the log-odds that depends on which visible points are matched."""

    @cached_property
    def matched(self) -> int:
        """Number of matches."""
        return int((self.assignment >= 0).sum())

    @property
    def misfit(self) -> float:
        """Factor on the variances that the fit asks for; see `PosteriorOptions.noise_freedom`."""
        given = DEFAULT_OPTIONS.noise_freedom
        return (given + self.chi2 + self.chi2_prior) / (given + self.dof)


class PriorFrame:
    """Source points, detections and a predicted pose.

    Parameters
    ----------
    task : MatchingTask
    prior : Pose
        With a covariance.
    """

    HIDDEN: ClassVar[float] = 0.1
    """Least visibility of a point with candidates."""

    def __init__(self, task: MatchingTask, prior: Pose) -> None:
        assert prior.covariance is not None
        points = task.points
        camera: CameraModel = task.problem.camera  # type: ignore[attr-defined]
        self.camera, self.target, sigma = camera.chart(points.target, points.detection_noise)
        self.source, self.normals, self.view_cosine = points.source, points.normals, points.view_cosine
        self.variance, self.source_covariance = sigma**2, points.source_covariance
        self.R, self.t = prior.R, prior.t
        deviation = np.sqrt(np.maximum(np.diag(prior.covariance), 1e-30))
        values, vectors = np.linalg.eigh(prior.covariance / np.outer(deviation, deviation))
        values = np.maximum(values, EXACT)
        scaled = vectors * deviation[:, None]
        self.covariance = (scaled * values) @ scaled.T
        self.precision = (vectors / values / deviation[:, None]) @ (vectors / deviation[:, None]).T
        self.log_precision = -float(np.log(values).sum() + 2.0 * np.log(deviation).sum())
        self.tilt = math.sqrt(max(float(np.linalg.eigvalsh(prior.covariance[:3, :3])[-1]), 0.0))
        self.detection = task.options.detection_rate or USUAL_DETECTION
        self.given_detection = task.options.detection_rate
        n_target = len(self.target)
        self.images = self.camera.images()
        areas = clutter_areas(self.target, sigma, self.images, self.camera.focal)
        self.area = float(areas[[len(own) > 0 for own in self.images]].sum() if self.images else areas[0])
        self.clutter = CROWDING * max(n_target, 1) / self.area
        self.allowed = np.ones((len(self.source), n_target), np.bool_) if task.allowed is None else task.allowed
        self.weight = candidate_log_odds(task)

    def moved(self, step: Floats) -> tuple[Floats, Floats]:
        """The predicted pose after a step (ω, τ)."""
        return one_rotation_matrix(step[:3]) @ self.R, self.t + step[3:]

    def projected(self, R: Floats, t: Floats) -> Projected:
        """Images of the source points in a pose, and their derivatives by it."""
        rotated = self.source @ R.T
        positions = rotated + t
        with np.errstate(all="ignore"):
            pixels, by_position = self.camera.project(positions), self.camera.jacobian(positions)
            sees = self.camera.sees(positions)
        jacobian = np.empty((len(positions), 2, 6))
        jacobian[..., 3:] = by_position
        (x, y, z), (a, b, c) = rotated.T[:, :, None], by_position.transpose(2, 0, 1)
        # −a [r]× = r × a, row by row
        jacobian[..., 0], jacobian[..., 1], jacobian[..., 2] = y * c - z * b, z * a - x * c, x * b - y * a
        whole = sees & np.isfinite(pixels).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
        visible = np.where(whole, self._facing(self.camera.from_centre(positions), R), 0.0)
        if self.images:
            visible *= self.camera.in_image(pixels)
        if not whole.all():
            pixels = np.where(whole[:, None], pixels, 1e9)
            jacobian = np.where(whole[:, None, None], jacobian, 0.0)
        of_points = None
        if self.source_covariance is not None:
            by_point = np.where(whole[:, None, None], by_position, 0.0) @ R
            of_points = by_point @ self.source_covariance @ by_point.swapaxes(-1, -2)
        return Projected(pixels, jacobian, visible, of_points)

    def _facing(self, positions: Floats, R: Floats) -> Floats:
        if self.normals is None:
            return np.ones(len(positions))
        length = np.sqrt((self.normals**2).sum(axis=1) * (positions**2).sum(axis=1))
        cosine = -((self.normals @ R.T) * positions).sum(axis=1) / np.where(length > 0.0, length, 1.0)
        if self.view_cosine is None:
            shown = cosine / FULLY
        else:
            shown = (cosine - self.view_cosine) / (VIEW_EDGE + EDGE * self.tilt) + HALF
        return np.where(length > 0.0, np.clip(shown, BARELY, 1.0), 1.0)

    def squared(self, pixels: Floats, spread: Floats) -> tuple[Floats, Floats]:
        """χ² (n, n') of each detection about each prediction, and the determinants of their covariance."""
        if len(pixels) <= ROWS:
            return squared_deviations(self.target, self.variance, pixels, spread)
        parts = []
        for first in range(0, len(pixels), ROWS):
            checkpoint()
            rows = slice(first, first + ROWS)
            parts.append(squared_deviations(self.target, self.variance, pixels[rows], spread[rows]))
        squared, determinant = (np.concatenate(part) for part in zip(*parts, strict=True))
        return squared, determinant

    def assigned(self, at: Projected, covariance: Floats, gate: float) -> Integers:
        """The most probable one-to-one assignment about a pose, with independent pairs."""
        from scipy.optimize import linear_sum_assignment  # slow to import

        squared, determinant = self.squared(at.pixels, at.spread(covariance))
        chance = self.detection * at.visible
        odds = np.log(np.maximum(chance, 1e-300) / (1.0 - np.minimum(chance, HIGHEST_RATE)) / self.clutter)
        gains = self.weight + odds[:, None] - 0.5 * (squared + np.log(determinant)) - math.log(2.0 * math.pi)
        possible = (squared <= gate**2) & (at.visible > self.HIDDEN)[:, None] & self.allowed & (gains > 0.0)
        assignment = np.full(len(at.pixels), -1, np.int64)
        rows = np.flatnonzero(possible.any(axis=1))
        if len(rows) == 0:
            return assignment
        if (possible.sum(axis=1) <= 1).all() and (possible.sum(axis=0) <= 1).all():
            assignment[rows] = possible[rows].argmax(axis=1)
            return assignment
        taken, images = linear_sum_assignment(np.where(possible[rows], -gains[rows], 0.0))
        good = possible[rows[taken], images]
        assignment[rows[taken[good]]] = images[good]
        return assignment

    def fitted(self, assignment: Integers, R: Floats, t: Floats, at: Projected | None = None) -> PriorFit:
        """The pose that fits an assignment and the prior best, from a start: damped Gauss–Newton.

        ``at``: what the start projects, where that is known. That of the fit may be a step of ``SETTLED`` behind.
        """
        used = np.flatnonzero(assignment >= 0)
        image = self.target[assignment[used]]
        if at is None:
            at = self.projected(R, t)
        weight = 1.0 / (self.variance[assignment[used]] + at.mean_of_points[used])
        root = np.sqrt(weight)
        chi2, chi2_prior, step = self._deviation(at, used, image, weight, (R, t))
        damping, diagonal = 0.0, np.arange(6)
        for _ in range(STEPS):
            rows = (at.jacobian[used] * root[:, None, None]).reshape(-1, 6)
            normal = rows.T @ rows + self.precision
            slope = ((at.pixels[used] - image) * root[:, None]).ravel() @ rows + self.precision @ step
            damped = normal.copy()
            damped[diagonal, diagonal] *= 1.0 + damping
            change = -np.linalg.solve(damped, slope)
            R2, t2 = one_rotation_matrix(change[:3]) @ R, t + change[3:]
            if damping == 0.0 and -float(slope @ change) < SETTLED * (1.0 + chi2):
                R, t = R2, t2
                break
            at2 = self.projected(R2, t2)
            chi22, prior2, step2 = self._deviation(at2, used, image, weight, (R2, t2))
            fall = chi2 + chi2_prior - chi22 - prior2
            if fall >= 0.0:
                R, t, at, chi2, chi2_prior, step = R2, t2, at2, chi22, prior2, step2
                damping = 0.1 * damping if damping > LEAST_DAMPING else 0.0
                if fall < SETTLED * (1.0 + chi2):
                    break
            else:
                damping = max(10.0 * damping, LEAST_DAMPING)
        rows = (at.jacobian[used] * root[:, None, None]).reshape(-1, 6)
        normal = rows.T @ rows + self.precision
        covariance = np.linalg.inv(normal)
        covariance = 0.5 * (covariance + covariance.T)
        evidence = -0.5 * (chi2 + chi2_prior + float(np.linalg.slogdet(normal)[1]) - self.log_precision)
        evidence += float(np.log(weight / (2.0 * math.pi)).sum()) + float(self.weight[used, assignment[used]].sum())
        chance = self.rate(assignment, at) * at.visible
        free = len(self.target) - len(used)
        odds = float(np.where(assignment >= 0, np.log(np.maximum(chance, 1e-300)), np.log1p(-chance)).sum())
        clutter = len(used) * math.log(CROWDING * (free + HALF) / self.area)
        return PriorFit(
            assignment=assignment,
            R=R,
            t=t,
            covariance=covariance,
            at=at,
            chi2=chi2,
            chi2_prior=chi2_prior,
            dof=2 * len(used),
            expected=float(at.visible.sum()),
            log_odds=evidence + odds - clutter,
            visibility=odds,
        )

    def _deviation(
        self, at: Projected, used: Integers, image: Floats, weight: Floats, pose: tuple[Floats, Floats]
    ) -> tuple[float, float, Floats]:
        """χ² of the detections and of the pose about the prior, and the step from the prior to it."""
        R, t = pose
        off = at.pixels[used] - image
        relative = R @ self.R.T
        step = np.concatenate([one_rotation_vector(relative), t - self.t])
        return float(((off**2).sum(axis=1) * weight).sum()), float(step @ self.precision @ step), step

    def rate(self, assignment: Integers, at: Projected) -> float:
        """Probability that a visible point is detected: as given, or as an assignment has it."""
        if self.given_detection is not None:
            return min(self.given_detection, HIGHEST_RATE)
        matched = int((assignment >= 0).sum())
        return min((matched + HALF) / (max(float(at.visible.sum()), matched) + 1.0), HIGHEST_RATE)

    def neighbours(self, fit: PriorFit) -> tuple[float, Integers]:
        """Summed odds of all one-change neighbours of a fitted assignment against it, to first order; the best one."""
        assignment, at = fit.assignment, fit.at
        matched = assignment >= 0
        image = np.maximum(assignment, 0)
        spread = at.of_pose(fit.covariance)
        # without its own match, a prediction moves away from it and is less certain (hat matrix)
        noise = self.variance[image] + at.mean_of_points
        hat = np.where(matched[:, None, None], spread / noise[:, None, None], 0.0)
        away = np.linalg.inv((1.0 + 1e-9) * np.eye(2) - hat)
        residual = self.target[image] - at.pixels
        alone = self.target[image] - (away @ residual[..., None])[..., 0]
        pixels = np.where(matched[:, None], alone, at.pixels)
        spread = np.where(matched[:, None, None], away @ spread, spread)
        squared, determinant = self.squared(pixels, spread if at.of_points is None else spread + at.of_points)
        chance = self.rate(assignment, at) * at.visible
        clutter = CROWDING * (len(self.target) - fit.matched + HALF) / self.area
        odds = np.log(np.maximum(chance, 1e-300) / (1.0 - np.minimum(chance, HIGHEST_RATE)) / clutter)
        gains = self.weight + odds[:, None] - 0.5 * (squared + np.log(np.maximum(determinant, 1e-300)))
        gains -= math.log(2.0 * math.pi)
        own = np.where(matched, gains[np.arange(len(assignment)), image], 0.0)
        gains = np.where(self.allowed & (at.visible > self.HIDDEN)[:, None], gains, -np.inf)
        unused = np.ones(len(self.target), np.bool_)
        unused[assignment[matched]] = False
        pairs, free = np.flatnonzero(matched), np.flatnonzero(unused)
        swapped = gains[np.ix_(pairs, assignment[pairs])]
        swaps = swapped + swapped.T - own[pairs, None] - own[None, pairs]
        swaps[np.tri(len(pairs), dtype=np.bool_)] = -np.inf
        moves, left = gains[:, free] - own[:, None], np.where(matched, -own, -np.inf)
        with np.errstate(over="ignore"):
            total = float(np.exp(left).sum() + np.exp(moves).sum() + np.exp(swaps).sum())
        best = assignment.copy()
        highest = [float(one.max(initial=-np.inf)) for one in (left, moves, swaps)]
        if highest[0] == max(highest):
            best[left.argmax()] = -1
        elif highest[1] == max(highest):
            i, j = np.unravel_index(moves.argmax(), moves.shape)
            best[i] = free[j]
        else:
            i, j = np.unravel_index(swaps.argmax(), swaps.shape)
            best[pairs[[i, j]]] = assignment[pairs[[j, i]]]
        return total, best

    def against_clutter(self, fit: PriorFit) -> float:
        """Log-odds of a fit against clutter with the local density of the detections."""
        used = fit.assignment[fit.assignment >= 0]
        density = crowded_density(self.target, math.sqrt(float(np.median(self.variance))), self.area, self.images)
        free = len(self.target) - len(used)
        uniform = CROWDING * (free + HALF) / self.area
        return fit.log_odds + len(used) * math.log(uniform) - float(np.log(CROWDING * density[used]).sum())


def unbiased_frame(task: MatchingTask, R: Floats, t: Floats, distance: float) -> PriorFrame:
    """A frame whose prior says nothing; ``distance``: of the body, by which that is measured."""
    vague = np.diag(np.repeat([VAGUE_ANGLE, VAGUE_LENGTH * distance], 3) ** 2)
    return PriorFrame(task, Pose.unchecked(R, t, vague))

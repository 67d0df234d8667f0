"""Evidence of a hypothesis: log-odds of an assignment and its pose against clutter alone, the pose integrated out.

For K hypotheses, each an owner map a and a pose T near which the integral is taken,

    log B = Σ_owned [log w − log f(y_j) − log 2π√|S_ij|] + log Γ(n' − k + ½) − log Γ(n' + ½)
          + log ∫ Beta(δ) Π_owned δ v_i Π_rest (1 − δ v_i) dδ
          + L(Q, f) + 3 log 2π − ½ log |A| + log p(T)

with f the density of clutter, k matches, S_ij = S_j + J Σ_i Jᵀ, A = Σ JᵀS⁻¹J + P the precision of the pose, Q the least
squared deviation of detections and prior to first order, and L the logarithm of e^(−Q/2) with a factor on all variances
integrated out. Poses need not be fitted: the minimum of Q is found to first order, and `Evidence.step` leads to it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.model.compiled.evidence import weigh
from rootmatch.model.compiled.residuals import residual_sums
from rootmatch.model.compiled.settling import EVIDENCE, IMAGES, POSES, settle_hypotheses
from rootmatch.model.compiled.steps import take_steps
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.linearised import NO_ROWS, Linearised, image_room, replace_array_rows
from rootmatch.model.pose_density import Mixture, PoseDensity
from rootmatch.problems.pose_fit.projection_model import group_by_point, shared_spread, ungroup_sightings

NOT_WHITE = np.empty((0, 0, 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0))
"""What the kernel gets where each detection has a noise of its own alone."""
ALL = math.inf, -math.inf, math.inf
"""Which hypotheses are fitted, for `settle_hypotheses`: all of them."""
NOWHERE = np.empty((0, 3, 3)), np.empty((0, 3))
"""Room for poses that are not asked for."""
STEEP = 0.5
"""Longest step of a settled pose, in radians and relative to the distance of the body. A round value."""
NO_CHANGE = 1e-2
"""Decrease of Q above which a step is worth another evaluation: below it, the evidence is known up to second order, and
the step itself is taken in the end. A round value."""

STEPS, MAX_STEPS, FAR = 2, 24, 1.0
"""Steps of every hypothesis, those of one that may count, and the decrease of Q above which that is still far from its
best pose. Where the image hardly tells some of the pose, as of nearly collinear points, two steps leave a fit with 1.2
times the stated noise at five times it, and eight leave a pose 12° from the best one that counts as another. Round
values."""
TOGETHER = 8
"""Hypotheses up to which all are weighed again rather than some of them picked out, which takes longer. A round
value."""
BEHIND = 30.0
"""Log-odds behind the best hypothesis from which the first steps have to do. A round value."""


class Evidence(NamedTuple):
    """Evidence of K hypotheses.

    Attributes
    ----------
    log_odds : (K,) float64
        log B, natural logarithm; −∞ for a match of a point that the camera cannot see, or that is not allowed.
    step : (K, 6) float64
        (ω, τ) from each pose to the best one, to first order; zero for a fitted pose.
    covariance : (K, 6, 6) float64
        Of the pose, prior included: rad, and the caller's unit of length.
    squared : (K,) float64
        Q, at the pose after the step.
    freedom : (K,) float64
        Degrees of freedom of that: two for each match, less the parameters that the detections determine.
    visible : (K, n) float64
        Visibility of each point, 0 to 1.
    decrement : (K,) float64
        Decrease of Q by the step.
    detected : (K,) float64
        Part of log B that tells which of the visible points are detected.
    """

    log_odds: Floats
    step: Floats
    covariance: Floats
    squared: Floats
    freedom: Floats
    visible: Floats
    decrement: Floats
    detected: Floats

    @property
    def place_log_odds(self) -> Floats:
        """Part (K,) of log B that tells where the detections are; −∞ where log B is."""
        return np.subtract(self.log_odds, self.detected, out=self.log_odds.copy(), where=np.isfinite(self.log_odds))

    def take(self, which: Integers | NDArray[np.bool_] | slice) -> Evidence:
        """Select some of the hypotheses."""
        return Evidence._make([one[which] for one in self])

    def replace_rows(self, which: Integers, others: Evidence) -> Evidence:
        """The same with others in the place of some."""
        return Evidence._make(replace_array_rows(one, which, other) for one, other in zip(self, others, strict=True))


def weigh_assignments(
    model: DetectionModel, assignments: Integers, at: Linearised, prior: PoseDensity | None = None
) -> Evidence:
    """Evidence of assignments (K, n), −1 for none, about poses of `DetectionModel.linearised`, or about one pose.

    ``prior``: of the pose, in the place of the model's own.
    """
    assignments = np.array(assignments, np.int64)
    prior = prior or model.prior
    if (mixture := kernel_mixture(model, prior)) is not None:
        return _settle_compiled(model, assignments, at, mixture, given=IMAGES)
    if len(at.seen) == 1 < len(assignments):
        at = at.take(np.zeros(len(assignments), np.int64))
    white = NOT_WHITE
    if model.has_covariances:
        used, image = assignments >= 0, np.maximum(assignments, 0)
        white = _whiten_matches(model, at, used, image, np.where(used[..., None], model.target[image] - at.pixels, 0.0))
    found = evidence_buffers(*assignments.shape)
    weigh(
        assignments,
        (at.pixels, at.jacobian, at.seen, at.expected, *at.for_kernels),
        white,
        tuple(np.array(one) for one in prior.components(at.rotation, at.position)),
        model.image_for_kernels,
        model.clutter.for_kernels,
        (*model.rate_quadrature, model.noise_freedom),
        tuple(found),
    )
    return found


def max_log_evidence(model: DetectionModel, minimal: int) -> float:
    """The largest log B of any pose of the broad prior whose place a minimal set of its matches tells.

    That set is taken to say nothing else; each further match is worth at most what it is exactly where it is predicted.
    """
    n, count = model.shape
    worth = np.sort(-(model.clutter.log_density + model.log_areas))[::-1]
    best = -math.inf
    for matches in range(minimal + 1, min(n, count) + 1):
        rest = math.lgamma(count - matches + 0.5) - math.lgamma(count + 0.5)
        best = max(best, float(worth[: matches - minimal].sum()) + rest)
    return best


def evidence_buffers(count: int, n: int) -> Evidence:
    """Room for the evidence of so many hypotheses of n points."""
    shapes = (count,), (count, 6), (count, 6, 6), (count,), (count,), (count, n), (count,), (count,)
    return Evidence._make(map(np.empty, shapes))


def kernel_mixture(model: DetectionModel, prior: PoseDensity | None = None) -> Mixture | None:
    """A prior, or the model's own, as kernels take it; None where NumPy has a part in that or in the scene."""
    return None if model.scene_for_kernels is None else (prior or model.prior).for_kernels


def _settle_compiled(
    model: DetectionModel,
    assignments: Integers,
    at: Linearised,
    prior: Mixture,
    *,
    given: int,
    maximum: int = 0,
    found: Evidence | None = None,
    hopeless: tuple[float, float, float] = ALL,
    after: tuple[Floats, Floats] = NOWHERE,
    spread: tuple[Floats, Floats] | None = None,
) -> Evidence:
    """What `settle_hypotheses` makes of hypotheses, in place: their evidence, and the images about their poses.

    ``spread``: in the place of `DetectionModel.spread_for_kernels`.
    """
    found = evidence_buffers(*assignments.shape) if found is None else found
    cosine = NO_ROWS if at.cosine is None else at.cosine
    settle_hypotheses(
        assignments, (*at[:4], cosine, at.expected, at.rotation, at.position), model.scene_for_kernels,
        spread or model.spread_for_kernels, prior, (given, maximum, STEPS, NO_CHANGE, FAR, BEHIND, STEEP, hopeless),
        tuple(found), after,
    )  # fmt: skip
    return found


def weigh_poses(
    model: DetectionModel, assignments: Integers, rotation: Floats, position: Floats, prior: PoseDensity | None = None
) -> tuple[Evidence, Linearised]:
    """Evidence of assignments (K, n) about poses (K, 3, 3) and (K, 3) of the body's centre, as they are."""
    if (mixture := kernel_mixture(model, prior)) is None:
        at = model.linearise_about(rotation, position)
        return weigh_assignments(model, assignments, at, prior), at
    at = image_room(model.shape[0], model.normals is not None, rotation, position)
    return _settle_compiled(model, np.array(assignments, np.int64), at, mixture, given=POSES), at


def settle_poses(
    model: DetectionModel, assignments: Integers, rotation: Floats, position: Floats, prior: PoseDensity | None = None
) -> tuple[Evidence, Linearised]:
    """As `settle_evidence`, from poses (K, 3, 3) and (K, 3) of the body's centre."""
    if (mixture := kernel_mixture(model, prior)) is None:
        return settle_evidence(model, assignments, *weigh_poses(model, assignments, rotation, position, prior), prior)
    at = image_room(model.shape[0], model.normals is not None, rotation, position)
    rows = np.array(assignments, np.int64)
    return _settle_compiled(model, rows, at, mixture, given=POSES, maximum=MAX_STEPS), at


def settle_with_errors(
    model: DetectionModel, assignment: Integers, pose: tuple[Floats, Floats], errors: Floats
) -> Floats | None:
    """Log-odds (W,) of an assignment (1, n) at its best pose if all points are off by each of some errors (W,).

    As `settle_poses` tells of a model with so much more covariance, from a pose (1, 3, 3) and (1, 3); None where
    kernels do not take the model.
    """
    if (mixture := kernel_mixture(model)) is None:
        return None
    of_points, of_detections = model.spread_for_kernels
    wide = np.zeros((len(errors), model.shape[0], 3, 3)) + (errors**2)[:, None, None, None] * np.eye(3)
    if len(of_points):
        wide += of_points
    at = image_room(model.shape[0], model.normals is not None, *pose)
    rows, out = np.array(assignment, np.int64), np.empty(len(errors))
    for k, one in enumerate(wide):
        at.rotation[:], at.position[:] = pose
        found = _settle_compiled(model, rows, at, mixture, given=POSES, maximum=MAX_STEPS, spread=(one, of_detections))
        out[k] = found.log_odds[0]
    return out


def settle_likely(
    model: DetectionModel,
    assignments: Integers,
    poses: tuple[Floats, Floats],
    prior: Mixture,
    hopeless: tuple[float, float, float],
) -> tuple[Evidence, Linearised, tuple[Floats, Floats]]:
    """`settle_poses` those of some assignments that may count, and their poses after the last steps, compiled.

    The others, and those that repeat another one, have log-odds of −∞. ``hopeless``: log-odds behind the best, least
    log-odds that this has, and log-odds from which any may count.
    """
    at, rows = image_room(model.shape[0], model.normals is not None, *poses), np.array(assignments, np.int64)
    after = np.empty(at.rotation.shape), np.empty(at.position.shape)
    found = _settle_compiled(model, rows, at, prior, given=POSES, maximum=MAX_STEPS, hopeless=hopeless, after=after)
    return found, at, after


def settle_evidence(
    model: DetectionModel, assignments: Integers, found: Evidence, at: Linearised, prior: PoseDensity | None = None
) -> tuple[Evidence, Linearised]:
    """Evidence after Gauss–Newton steps to the best poses, starting from that about the given poses.

    The steps of a hypothesis end when they no longer change its fit or, after the first `STEPS`, if it is far behind
    the best one. What is given may change in place.
    """
    if (mixture := kernel_mixture(model, prior)) is not None:
        rows = np.array(assignments, np.int64)
        return _settle_compiled(model, rows, at, mixture, given=EVIDENCE, maximum=MAX_STEPS, found=found), at
    for turn in range(MAX_STEPS):
        going = found.decrement >= (NO_CHANGE if turn < STEPS else FAR)
        if turn >= STEPS:
            going &= found.log_odds > found.log_odds.max() - BEHIND
        (some,) = np.nonzero(going)
        if not len(some):
            break
        if len(some) == len(going) or len(going) <= TOGETHER:
            at = model.linearise_about(*step_poses(found._replace(step=found.step * going[:, None]), at))
            found = weigh_assignments(model, assignments, at, prior)
            continue
        there = model.linearise_about(*step_poses(found.take(some), at.take(some)))
        at, found = (
            at.replace_rows(some, there),
            found.replace_rows(some, weigh_assignments(model, assignments[some], there, prior)),
        )
    return found, at


def step_poses(found: Evidence, at: Linearised) -> tuple[Floats, Floats]:
    """Rotations (K, 3, 3) and positions (K, 3) after each step, which is shortened to where first order may hold."""
    out = np.empty(at.rotation.shape), np.empty(at.position.shape)
    take_steps(found.step, at.rotation, at.position, STEEP, out)
    return out


def squared_deviations(model: DetectionModel, assignments: Integers, at: Linearised) -> Floats:
    """Squared deviations (K,) of the detections of assignments (K, n) from poses, in units of their noise."""
    return np.asarray((normalised_deviations(model, assignments, at)[0] ** 2).sum(axis=(1, 2)))


def residual_statistics(
    model: DetectionModel, assignment: Integers, rotation: Floats, position: Floats
) -> tuple[float, float]:
    """Squared deviation of an assignment (n,) from a pose (3, 3) and (3,), and how far its detections move with points.

    Both are in units of the noise; the second is the mean square on an axis, by a coordinate of a detection's point.
    """
    if (scene := model.exact_scene_for_kernels) is not None:
        pose, row = (np.array(rotation[None]), np.array(position[None])), np.array(assignment, np.int64)
        squared, moved = residual_sums(row, pose, *scene[:3])
        return squared, moved
    at, used = model.linearise_about(rotation[None], position[None]), assignment >= 0
    each = 0.5 * (at.by_position[0, used] ** 2).sum(axis=(1, 2)) / model.sigma[assignment[used]] ** 2
    return float(squared_deviations(model, assignment[None], at)[0]), float(each.sum()) / max(len(each), 1)


def normalised_deviations(model: DetectionModel, assignments: Integers, at: Linearised) -> tuple[Floats, Floats]:
    """Deviations (K, n, 2) of the detections of assignments (K, n) from poses, and the images' Jacobians (K, n, 2, 6).

    Both are in units of the noise.
    """
    used, image = assignments >= 0, np.maximum(assignments, 0)
    offset = np.where(used[..., None], model.target[image] - at.pixels, 0.0)
    if model.has_covariances:
        rows, residual, _ = _whiten_matches(model, at, used, image, offset)
        return residual, rows
    sigma = model.noise_of(at, image)[..., None]
    return np.asarray(offset / sigma), np.asarray(at.jacobian * used[..., None, None] / sigma[..., None])


def _whiten_matches(
    model: DetectionModel, at: Linearised, used: NDArray[np.bool_], image: Integers, offset: Floats
) -> tuple[Floats, Floats, Floats]:
    """Jacobians (K, n, 2, 6) and residuals (K, n, 2) in units of the noise, and ½ log |S| (K, n); zero if unmatched.

    With the covariances of points, which their sightings share, and of detections.
    """
    images, (_, spread) = max(len(model.images), 1), match_covariances(model, at, used, image)
    root = np.linalg.cholesky(spread)
    rows = ungroup_sightings(np.linalg.solve(root, group_by_point(at.jacobian * used[..., None, None], images)), images)
    residual = ungroup_sightings(np.linalg.solve(root, group_by_point(offset[..., None], images)), images)[..., 0]
    logarithm = np.log(np.diagonal(root, axis1=-1, axis2=-2))[..., None]
    return rows, residual, ungroup_sightings(logarithm, images)[..., 0].sum(axis=-1)


def match_covariances(
    model: DetectionModel, at: Linearised, used: NDArray[np.bool_], image: Integers
) -> tuple[Floats, Floats]:
    """Derivatives (K, C n, 2, 3) of sightings by the points in the body's frame, and covariances (K, n, 2 C, 2 C)."""
    each = used[..., None, None]
    own = np.where(each, model.assigned_covariances(at, image), np.eye(2))
    by_point = np.where(each, at.by_position @ at.rotation[:, None], 0.0)
    return by_point, shared_spread(by_point, model.source_covariance, own, max(len(model.images), 1))

"""Matching with a predicted pose: candidates from its covariance, a one-to-one assignment, and a fit with it (NumPy).

A good prediction leaves one detection or two for each point. Those are assigned and fitted at once. If gates hold
several detections, single correspondences are tried first: each moves the whole prediction and narrows all other gates
(a Kalman update). The assignments that explain most are fitted. The prediction is a Gaussian in every fit. No minimal
sets are solved and nothing is compiled: a frame takes about a millisecond.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross_matrix, rotation_from_vector
from rootmatch.deadline import checkpoint
from rootmatch.explain.image_density import normal_density
from rootmatch.explain.predicted_likelihood import Floats, Integers, PriorFit, PriorFrame
from rootmatch.explain.projected import Projected
from rootmatch.explain.rig_copies import RigCopies
from rootmatch.explain.task import MatchingTask
from rootmatch.options import Options, option
from rootmatch.problems.pose_fit.base import invertible
from rootmatch.problems.pose_fit.camera_pose import camera_poses
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.rig_fit import rig_pose
from rootmatch.problems.up2p import UP2P


@dataclass(frozen=True)
class PriorOptions(Options):
    """Options for the use of a predicted pose; what it finds and costs: benchmarks/tracking.py."""

    gate: float = option(4.0, above=0.0)
    """Standard deviations of a prediction, its own and the detection's, within which a detection is a candidate."""
    most_pairs: int = option(400, least=1)
    """Candidate pairs in an image beyond which a prior is too wide to decide alone."""
    tried: int = option(64, least=1)
    """Most single correspondences that are tried, those of the points with the fewest candidates. Not tuned."""
    beams: int = option(4, least=1)
    """Hypotheses that are fitted: four find as much as eight (benchmarks/tracking.py, six flights, seeds from 1000)."""
    complete: float = option(0.8, above=0.0, most=1.0)
    """Share of the visible points from which the first assignment is accepted without trying others, if it also
    fits."""
    fitting: float = option(2.5, above=0.0)
    """χ² over its degrees of freedom up to which it fits."""
    changes: int = option(3, least=0)
    """Number of single changes of the best assignment that are tried in turn if one is more likely, as for a point
    beyond the gate. A round value."""
    least: int = option(3, least=1)
    """Fewest matches of an assignment that is accepted."""
    beyond_chance: float = option(4.6, least=0.0)
    """Log-odds against clutter alone, minus the logarithm of the hypotheses tried, from which it is accepted: e⁴·⁶ is
    100."""
    contradicted: float = option(45.0, above=0.0)
    """χ² of a pose about the prior, with six degrees of freedom, from which the prior counts as wrong: fewer than one
    in 10⁷ right priors."""
    undoubted: float = option(0.95, above=0.0, most=1.0)
    """Probability of an assignment below which the next one is fitted as well. A round value."""
    most_misfit: float = option(4.0, above=1.0)
    """Factor on the stated variances beyond which no assignment is accepted, as in `PosteriorOptions`."""


DEFAULT_PRIOR = PriorOptions()
LEAST_TILT = 1e-5
"""Standard deviation, in radians, of a vertical that is called exact."""


@dataclass(frozen=True, eq=False)
class Found:
    """The result of a match with a prior.

    Attributes
    ----------
    assignment : (n,) int64
    pose : Pose
        Of the prior and the matches together, with its covariance.
    log_odds : float
        Against clutter alone.
    probability : float
        Of the assignment, among those considered.
    chi2_prior : float
        Of the pose about the prior.
    alternatives : list of ((n,) int64, float)
        Others with their log-odds.
    believed : bool
        Whether it is beyond chance, fits, and does not contradict the prior.
    tested : int
        Hypotheses that were tried.
    beyond_chance : float
        Log-odds against clutter that crowds as the detections do, minus the logarithm of ``tested``.
    visibility : float
        Part of ``log_odds`` that depends on which of the visible points are matched.
    expected : float
        Visible points.
    runner_up : PriorFit or None
        The next most probable assignment, fitted, if the first is in doubt.
    fits : list of PriorFit
        Of the assignment and of the alternatives.
    """

    assignment: Integers
    pose: Pose
    log_odds: float
    probability: float
    chi2_prior: float
    alternatives: list[tuple[Integers, float]]
    believed: bool
    tested: int
    beyond_chance: float
    visibility: float
    expected: float
    runner_up: PriorFit | None = None
    fits: list[PriorFit] = field(default_factory=list)

    @property
    def matched(self) -> int:
        """Number of matches."""
        return int((self.assignment >= 0).sum())


def match_with_prior(task: MatchingTask, prior: Pose, options: PriorOptions = DEFAULT_PRIOR) -> Found | None:
    """The match about a predicted pose; None if it has no candidates, or too many.

    Parameters
    ----------
    task : MatchingTask
        Of a problem with a camera pose; there may be fewer detections than a hyper-edge needs.
    prior : Pose
        With a covariance.
    options : PriorOptions
    """
    frame = PriorFrame(task, prior)
    first = frame.projected(frame.R, frame.t)
    spread = first.spread(frame.covariance)
    squared, _ = frame.squared(first.pixels, spread)
    candidates = (squared <= options.gate**2) & (first.visible > frame.HIDDEN)[:, None] & frame.allowed
    pairs = int(candidates.sum())
    if not 0 < pairs <= options.most_pairs * max(len(frame.images), 1):
        return None
    known: dict[bytes, PriorFit] = {}
    fits = [_settled(frame, frame.R, frame.t, frame.covariance, options=options, known=known, at=first)]
    tested = 1
    if not _convincing(fits[0], options):
        starts = _narrowed(frame, first, candidates, options)
        tested += pairs
        fits += [_settled(frame, *start, options=options, known=known) for start in starts]
    distinct = {fit.assignment.tobytes(): fit for fit in fits if fit is not None}
    ranked = sorted(distinct.values(), key=lambda fit: -fit.log_odds)
    if not ranked:
        return None
    best = ranked[0]
    near, better = frame.neighbours(best)
    for _ in range(options.changes):
        if near <= 1.0:
            break
        fit = frame.fitted(better, best.R, best.t, best.at)
        if fit.log_odds <= best.log_odds:
            break
        ranked.insert(0, fit)
        best = fit
        near, better = frame.neighbours(best)
    others = sum(math.exp(max(fit.log_odds - best.log_odds, -700.0)) for fit in ranked[1:])
    probability = 1.0 / (1.0 + others + near)
    runner_up = None
    if probability < options.undoubted:
        if all(not np.array_equal(fit.assignment, better) for fit in ranked):
            ranked.append(frame.fitted(better, best.R, best.t, best.at))
        ranked[1:] = sorted(ranked[1:], key=lambda fit: -fit.log_odds)
        runner_up = ranked[1]
    beyond = frame.against_clutter(best) - math.log(tested)
    believed = (
        best.matched >= options.least
        and beyond > options.beyond_chance
        and best.chi2_prior < options.contradicted
        and best.misfit <= options.most_misfit
    )
    pose = Pose.unchecked(best.R, best.t, best.covariance)
    alternatives = [(fit.assignment, fit.log_odds) for fit in ranked[1:]]
    return Found(
        assignment=best.assignment,
        pose=pose,
        log_odds=best.log_odds,
        probability=probability,
        chi2_prior=best.chi2_prior,
        alternatives=alternatives,
        believed=believed,
        tested=tested,
        beyond_chance=beyond,
        visibility=best.visibility,
        expected=best.expected,
        runner_up=runner_up,
        fits=ranked,
    )


def _convincing(fit: PriorFit | None, options: PriorOptions) -> bool:
    """Whether an assignment explains nearly all that should be visible, and fits."""
    if fit is None or fit.matched < options.least + 1:
        return False
    return fit.matched >= options.complete * fit.expected and fit.chi2 <= options.fitting * max(fit.dof, 1)


def _settled(
    frame: PriorFrame,
    R: Floats,
    t: Floats,
    covariance: Floats,
    *,
    options: PriorOptions,
    known: dict[bytes, PriorFit],
    at: Projected | None = None,
) -> PriorFit | None:
    """Assignment and fit in turn until the assignment stays; ``at``: what the start projects, where that is known.

    ``known``: the fits of assignments that other starts have met, to which those of this one are added.
    """
    if at is None:
        at = frame.projected(R, t)
    assignment = frame.assigned(at, covariance, options.gate)
    fit = None
    for _ in range(5):
        if not (assignment >= 0).any():
            return None
        key = assignment.tobytes()
        fit = known.get(key) or frame.fitted(assignment, R, t, at)
        known[key] = fit
        new = frame.assigned(fit.at, fit.covariance, options.gate)
        if np.array_equal(new, assignment):
            break
        assignment, R, t, at = new, fit.R, fit.t, fit.at
    return fit


def _narrowed(
    frame: PriorFrame, first: Projected, candidates: NDArray[np.bool_], options: PriorOptions
) -> list[tuple[Floats, Floats, Floats]]:
    """Poses and covariances after one correspondence each, those that explain most; after two if one is not enough."""
    beams = [(0.0, np.zeros(6), frame.covariance)]
    for _ in range(2):
        steps, covariances, scores = [], [], []
        for _, step, covariance in beams:
            checkpoint()
            one = _updates(frame, first, step, covariance, candidates=candidates, options=options)
            if one is not None:
                steps.append(one[0])
                covariances.append(one[1])
                scores.append(one[2])
        if not steps:
            break
        every, spread, score = np.concatenate(steps), np.concatenate(covariances), np.concatenate(scores)
        best = np.argsort(-score, kind="stable")
        _, distinct = np.unique(np.round(score[best], 6), return_index=True)
        best = best[np.sort(distinct)][: options.beams]
        beams = [(float(score[k]), every[k], spread[k]) for k in best]
    return [(*frame.moved(step), covariance) for _, step, covariance in beams]


def _updates(
    frame: PriorFrame,
    first: Projected,
    step: Floats,
    covariance: Floats,
    *,
    candidates: NDArray[np.bool_],
    options: PriorOptions,
) -> tuple[Floats, Floats, Floats] | None:
    """Steps (P, 6), covariances (P, 6, 6) and scores (P,) after a Kalman update with each of some candidate pairs."""
    pixels = first.pixels + first.jacobian @ step
    spread = first.spread(covariance)
    squared, _ = frame.squared(pixels, spread)
    near = candidates & (squared <= options.gate**2)
    counts = near.sum(axis=1)
    vague = np.trace(spread, axis1=1, axis2=2)
    # vague points are the most informative, and few candidates the cheapest
    order = np.argsort(np.where(counts > 0, counts - vague / (vague.max() + 1e-300), np.inf), kind="stable")
    order = order[counts[order] > 0]
    taken = order[np.cumsum(counts[order]) <= options.tried]
    i, j = np.nonzero(near[taken if len(taken) else order[:1]])
    if not len(i):
        return None
    i = (taken if len(taken) else order[:1])[i]
    jacobian = first.jacobian[i]
    gain = covariance @ jacobian.swapaxes(-1, -2)
    total = jacobian @ gain + (frame.variance[j] + first.mean_of_points[i])[:, None, None] * np.eye(2)
    kalman = gain @ np.linalg.inv(invertible(total))
    steps = step + (kalman @ (frame.target[j] - pixels[i])[..., None])[..., 0]
    covariances = covariance - kalman @ gain.swapaxes(-1, -2)
    shown = np.flatnonzero(candidates.any(axis=1))
    rows = first.jacobian[shown]
    moved = first.pixels[shown] + np.einsum("nqp,kp->knq", rows, steps)
    spreads = np.einsum("nqp,kpr,nsr->knqs", rows, covariances, rows, optimize=True)
    if first.of_points is not None:
        spreads += first.of_points[shown]
    density = normal_density(frame.target, frame.variance, moved, spreads)
    density = np.where(frame.allowed[shown], density, 0.0)
    chance = frame.detection * first.visible[shown]
    ratio = 1.0 - chance + chance * (density / frame.clutter).max(axis=2)
    return steps, covariances, np.log(ratio).sum(axis=1)


def with_vertical(prior: Pose, world: Floats, camera: Floats, noise: float) -> Pose:
    """The prediction combined with a measured vertical.

    Parameters
    ----------
    prior : Pose
    world, camera : (3,) arrays
        The vertical in the frame of the points and in that of the camera, of any length.
    noise : float
        Standard deviation of the second on each of two axes, in radians.
    """
    assert prior.covariance is not None
    down = prior.R @ (world / np.linalg.norm(world))
    measured = camera / np.linalg.norm(camera)
    jacobian = np.concatenate([-cross_matrix(down), np.zeros((3, 3))], axis=1)
    gain = prior.covariance @ jacobian.T
    total = jacobian @ gain + max(noise, LEAST_TILT) ** 2 * np.eye(3)
    kalman = gain @ np.linalg.inv(total)
    step = kalman @ (measured - down)
    covariance = prior.covariance - kalman @ gain.T
    return Pose(
        rotation_from_vector(step[None, :3])[0] @ prior.R, prior.t + step[3:], 0.5 * (covariance + covariance.T)
    )


def prior_of(task: MatchingTask) -> Pose:
    """The prediction of a task, combined with the vertical if that is measured."""
    assert task.prior_pose is not None
    problem = task.problem
    if isinstance(problem, UP2P):
        return with_vertical(
            task.prior_pose,
            np.asarray(problem.vertical_world, float),
            np.asarray(problem.vertical_camera, float),
            problem.vertical_noise,
        )
    return task.prior_pose


def fused_pose(task: MatchingTask, assignment: Integers) -> Pose | None:
    """The most likely pose of an assignment (n,) and the prediction together, with its residuals."""
    points, problem = task.points, task.problem
    if isinstance(problem, RigCopies):
        return rig_pose(problem.copies, points, assignment, prior_of(task))
    return camera_poses(points, problem.camera, assignment[None], prior=prior_of(task))[0]  # type: ignore[attr-defined]

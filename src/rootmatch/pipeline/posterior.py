"""Posterior probability of assignments: each is fitted by one pose, and their neighbours are searched as well."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import Pace
from rootmatch.hypergraph.neighbourhood import Changes, one_change_neighbours
from rootmatch.pipeline.confidence import Marginals, marginals
from rootmatch.pipeline.detection_odds import (
    DEFAULT_OPTIONS,
    HALF,
    MOST_DETECTED,
    PosteriorOptions,
    log_odds,
    log_odds_against_clutter,
    log_odds_against_uniform,
    visibility,
)
from rootmatch.pipeline.task import MatchingTask
from rootmatch.problems.pose_fit.base import Fit
from rootmatch.samplers.guided.detection_grid import local_density

Integers = NDArray[np.int64]


FITTED_FIRST = 8
"""Assignments fitted at first where there is a deadline: that takes hardly longer than one."""
IMPOSSIBLE = -1e9
"""Log-odds in the place of −∞, so that differences stay numbers."""


class Misfit(NamedTuple):
    """How much larger the noise looks than it was given, by the residuals of an assignment about its best pose."""

    variances: float
    """Factor on the variances that is believed, infinite where no pose fits: the given σ counts for
    `PosteriorOptions.noise_freedom` residuals."""
    sigma: float
    """Factor on σ by the residuals alone; NaN where a pose leaves none."""
    freedom: int
    """Degrees of freedom of that."""

    @classmethod
    def of(cls, chi2: float, freedom: int, options: PosteriorOptions = DEFAULT_OPTIONS) -> Misfit:
        """That of a fit with this χ²."""
        given = options.noise_freedom
        sigma = math.sqrt(chi2 / freedom) if freedom else math.nan
        return cls((given + chi2) / (given + freedom), sigma, freedom)

    @property
    def chance(self) -> float:
        """How often residuals are as large as that where σ is right."""
        from scipy.special import gammaincc  # slow to import, rarely needed

        if not self.freedom:
            return 1.0
        return float(gammaincc(0.5 * self.freedom, 0.5 * self.freedom * self.sigma**2))


NO_POSE = Misfit(math.inf, math.nan, 0)


@dataclass(frozen=True)
class Ranked:
    """Assignments, the most probable first unless none is probable and the hypotheses of a search agree on another.

    Attributes
    ----------
    assignments : list of (n,) int64 arrays
    logarithms : (K,) array
        Log-odds of each against the most probable one, which stands first unless the hypotheses of a search agree on
        another.
    """

    assignments: list[Integers]
    logarithms: NDArray[np.float64]
    beyond_chance: float
    """Log-odds of the first assignment against none, all detections clutter; NaN where unknown."""
    misfit: Misfit
    """Of the first assignment."""
    marginals: Marginals | None = None
    """Of the first assignment, point by point."""

    @property
    def probability(self) -> float:
        """Posterior probability of the first assignment, given that one of them is right."""
        return self.probability_of(1)

    def probability_of_assignment(self, assignment: Integers) -> float:
        """Posterior probability of one of the assignments, 0 where it is none of them."""
        shares = np.exp(self.logarithms)
        same = [np.array_equal(other, assignment) for other in self.assignments]
        return float(shares[same].sum() / shares.sum())

    @property
    def probabilities(self) -> NDArray[np.float64]:
        """Posterior probability of each assignment (K,), given that one of them is right."""
        shares = np.exp(self.logarithms)
        return np.asarray(shares / shares.sum())

    def probability_of(self, count: int) -> float:
        """Posterior probability that the right assignment is among the first ``count``."""
        shares = np.exp(self.logarithms)
        return float(shares[:count].sum() / shares.sum())


def ranked(
    task: MatchingTask,
    assignments: list[Integers],
    options: PosteriorOptions = DEFAULT_OPTIONS,
    consensus: Integers | None = None,
) -> Ranked:
    """Rank assignments, and those near the most probable ones, by posterior probability.

    The posterior of an assignment is the likelihood of its detections about its best pose, the pose integrated out,
    against clutter of uniform density. Neighbours differ by a point left out, added or moved to a free detection, or
    by two points with exchanged detections.

    Parameters
    ----------
    task : MatchingTask
        Of a problem that can fit assignments.
    assignments : list of (n,) int64 arrays
        The best one first.
    options : PosteriorOptions
    consensus : (n,) int64 array, optional
        What the hypotheses of a search agree on; it stands first where no assignment is probable.
    """
    if consensus is not None:
        assignments = [*assignments, consensus]
    least = task.problem.minimal + 1
    pool = {assignment.tobytes(): assignment for assignment in assignments if (assignment >= 0).sum() >= least}
    fits: dict[bytes, tuple[Fit, int]] = {}
    visible: dict[bytes, NDArray[np.float64]] = {}
    value: dict[bytes, float] = {}
    visited: set[bytes] = set()
    leader, detected = assignments[0], _detected(task, assignments[0], np.ones(task.shape[0]))
    pace = Pace(task.deadline, FITTED_FIRST)
    for turn in range(options.rounds + 1):
        new = _fits(task, [key for key in pool if key not in fits], pool, pace)
        fits |= new
        visible |= {key: visibility(task, fit, k, options) for key, (fit, k) in new.items()}
        inflation = _inflation(fits, options)
        # clutter and the share of the visible points that is detected are those of the best assignment
        for _ in range(2):
            odds = log_odds(task, leader)
            for key, (fit, k) in fits.items():
                matched = pool[key] >= 0
                chance = detected * visible[key]
                total = float(fit.inflated(inflation)[k] + odds[matched, pool[key][matched]].sum())
                total += float(np.where(matched, np.log(chance), np.log1p(-chance)).sum())
                value[key] = total if np.isfinite(total) else -np.inf
            best = max(value, key=lambda key: value[key], default=None)
            if best is None or value[best] == -np.inf:
                break
            before = leader, detected
            leader, detected = pool[best], _detected(task, pool[best], visible[best])
            if detected == before[1] and np.array_equal(leader, before[0]):
                break
        if turn == options.rounds or not value or task.deadline.left() <= 0.0:
            break
        enough = max(value.values()) - options.negligible_odds
        near = [key for key in sorted(value, key=lambda key: -value[key]) if value[key] > enough]
        waiting = [key for key in near if key not in visited][: options.searched_per_round]
        if not waiting:
            break
        for key in waiting:
            visited.add(key)
            fit, k = fits[key]
            gains = _gains(task, pool[key], fit.densities(k, inflation) + odds, detected * visible[key], fit=fit, k=k)
            for other, gain in _neighbours(*_changes(gains, pool[key]), pool[key], options):
                if value[key] + gain > enough and (other >= 0).sum() >= least:
                    pool.setdefault(other.tobytes(), other)
    order = sorted(value, key=lambda key: (-value[key], key))
    order = [key for key in order if value[key] > -np.inf]
    highest = max(value.values(), default=0.0)
    if consensus is not None and consensus.tobytes() in order:
        shares = np.exp([(value[key] - highest) / fits[key][0].doubt for key in order])
        if 1.0 / shares.sum() < options.agreed:
            order.remove(consensus.tobytes())
            order.insert(0, consensus.tobytes())
    logarithms = np.array([(value[key] - highest) / fits[key][0].doubt for key in order])
    if not order:
        return Ranked([], logarithms, np.nan, NO_POSE)
    fit, k = fits[order[0]]
    image, sigma = task.image
    density = local_density(image.T, float(np.median(sigma)))
    beyond = float(fit.inflated(inflation)[k]) + fit.of_pose(k, density)
    if task.problem.source_is_image:  # a second image is full of detections, an object is a cluster of them
        beyond += log_odds_against_uniform(task, pool[order[0]])
    else:
        rate = task.options.detection
        beyond += log_odds_against_clutter(pool[order[0]], visible[order[0]], density, options, rate)
    first, every = pool[order[0]], [pool[key] for key in order]
    gains = _gains(task, first, fit.densities(k, inflation) + odds, detected * visible[order[0]], fit=fit, k=k)
    each = marginals(every, logarithms, *_changes(gains, first), fit.doubt)
    return Ranked(every, logarithms, beyond, _misfit(fit, k, options), each)


def _gains(
    task: MatchingTask,
    assignment: Integers,
    density: NDArray[np.float64],
    chance: NDArray[np.float64],
    fit: Fit,
    k: int,
) -> NDArray[np.float64]:
    """Log-odds (n, n') of each correspondence against none, given the rest of an assignment and its pose.

    ``density`` (n, n') of each detection about its prediction over that of clutter; ``chance`` (n,) that a point is
    detected.
    """
    gains: NDArray[np.float64] = density + (np.log(chance) - np.log1p(-chance))[:, None]
    if task.points.normals is not None:
        gains[(assignment < 0) & fit.invisible(k, task.points.normals)] = -np.inf
    return gains


def misfit(task: MatchingTask, assignment: Integers, options: PosteriorOptions = DEFAULT_OPTIONS) -> Misfit:
    """How much larger the noise looks by the residuals of an assignment about its best pose."""
    return _misfit(task.problem.fitted(task.points, assignment[None]), 0, options)


def _misfit(fit: Fit, k: int, options: PosteriorOptions) -> Misfit:
    return Misfit.of(float(fit.chi2[k]), max(int(fit.freedom[k]), 0), options)


def _detected(task: MatchingTask, assignment: Integers, visible: NDArray[np.float64]) -> float:
    """Probability that a visible point is detected: as given, or as an assignment has it."""
    if task.options.detection is not None:
        return min(task.options.detection, MOST_DETECTED)
    matched = int((assignment >= 0).sum())
    return (matched + HALF) / (max(float(visible.sum()), matched) + 1.0)


def _fits(
    task: MatchingTask, keys: list[bytes], pool: dict[bytes, Integers], pace: Pace
) -> dict[bytes, tuple[Fit, int]]:
    """Pose fits of some assignments of the pool, and their rows in them; the first of them where time is up."""
    fits: dict[bytes, tuple[Fit, int]] = {}
    while len(fits) < len(keys) and (few := pace.block(len(keys) - len(fits))):
        some = keys[len(fits) : len(fits) + few]
        fit = task.problem.fitted(task.points, np.array([pool[key] for key in some]))
        fits |= {key: (fit, k) for k, key in enumerate(some)}
    return fits


def _inflation(fits: dict[bytes, tuple[Fit, int]], options: PosteriorOptions) -> float:
    """Factor on the given variances that the best fitting assignment asks for; at least 1.

    Only assignments count that match hardly fewer points than the first: the fewer, the better they fit. Bounded, so
    that an assignment which no pose fits does not become probable by taking everything for noise.
    """
    first, row = next(iter(fits.values()), (None, 0))
    least = 0 if first is None else int(first.freedom[row]) - options.freedom_slack
    fair = [_misfit(fit, k, options).variances for fit, k in fits.values() if int(fit.freedom[k]) >= least]
    return min(max(1.0, min(fair, default=1.0)), options.most_inflation)


def _changes(gains: NDArray[np.float64], assignment: Integers) -> tuple[Changes, NDArray[np.float64]]:
    """All changes of an assignment, and their log-odds against it to first order.

    ``gains`` (n, n') holds the log-odds of each correspondence against none, given the rest of the assignment.
    """
    own = np.where(assignment >= 0, gains[np.arange(len(assignment)), np.maximum(assignment, 0)], 0.0)
    own = np.where(np.isfinite(own), own, IMPOSSIBLE)
    changes = one_change_neighbours(assignment, gains.shape[1], resize=True)
    second = changes.other >= 0
    change = np.where(changes.target >= 0, gains[changes.source, changes.target], 0.0)
    change[second] += gains[changes.other[second], changes.other_target[second]]
    change -= own[changes.source]
    change[second] -= own[changes.other[second]]
    return changes, change


def _neighbours(
    changes: Changes, change: NDArray[np.float64], assignment: Integers, options: PosteriorOptions
) -> list[tuple[Integers, float]]:
    """The most probable changes of an assignment, and their log-odds against it to first order."""
    chosen = np.flatnonzero(change > -options.neighbour_odds)
    chosen = chosen[np.argsort(-change[chosen], kind="stable")[: options.neighbours]]
    return list(zip(changes.take(chosen).applied_to(assignment), change[chosen].tolist(), strict=True))

"""Posterior probability of assignments between two views: each assignment and each neighbour is fitted by one pose."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import Pace
from rootmatch.explain.confidence import Marginals, marginals, of_one_pose
from rootmatch.explain.detection_odds import (
    DEFAULT_OPTIONS,
    HALF,
    PosteriorOptions,
    log_odds,
    log_odds_against_uniform,
)
from rootmatch.explain.fitted_pool import FittedPool
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.neighbourhood import Changes, likely_changes
from rootmatch.model.detection_model import HIGHEST_RATE
from rootmatch.problems.noise import usual_noise
from rootmatch.problems.pose_fit.base import Fit
from rootmatch.problems.pose_fit.relative import RelativeFit
from rootmatch.samplers.guided.detection_grid import local_density

Integers = NDArray[np.int64]


FITTED_FIRST = 8
"""Assignments fitted first if there is a deadline: they take hardly longer than one."""
IMPOSSIBLE = -1e9
"""Log-odds in the place of −∞, so that differences stay numbers."""
OUT_OF_THE_QUESTION = 40.0
"""Log-odds against a change beyond which it adds nothing in double precision."""


class Misfit(NamedTuple):
    """Ratio of the noise that the residuals of an assignment about its best pose suggest to the stated noise."""

    variances: float
    """Estimated factor on the variances, infinite if no pose fits: the stated σ counts as
    `PosteriorOptions.noise_freedom` residuals."""
    sigma: float
    """Factor on σ by the residuals alone; NaN where a pose leaves none."""
    dof: int
    """Degrees of freedom of that."""

    @classmethod
    def of(cls, chi2: float, freedom: int, options: PosteriorOptions = DEFAULT_OPTIONS) -> Misfit:
        """The misfit of a pose with this χ²."""
        given = options.noise_freedom
        sigma = math.sqrt(chi2 / freedom) if freedom else math.nan
        return cls((given + chi2) / (given + freedom), sigma, freedom)

    @property
    def chance(self) -> float:
        """Probability of residuals at least as large if σ is right."""
        from scipy.special import gammaincc  # slow to import, rarely needed

        if not self.dof:
            return 1.0
        return float(gammaincc(0.5 * self.dof, 0.5 * self.dof * self.sigma**2))


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
        if count >= len(self.assignments):
            return 1.0
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
    pool = FittedPool(task, task.problem.minimal + 1, options)
    # changes of one point are among the neighbours of the first
    near_first = _has_many(task, assignments[0], options)
    for assignment in assignments:
        if not near_first or (assignment != assignments[0]).sum() != 1 or assignment is consensus:
            pool.add(assignment)
    visited: set[int] = set()
    beside: list[tuple[Integers, int, float]] = []
    leader, detected = assignments[0], _detected(task, assignments[0])
    pace, best, inflation, known = Pace(task.deadline, FITTED_FIRST), -1, 1.0, _NOTHING_KNOWN
    for turn in range(options.rounds + 1):
        pool.fit(pace)
        inflation, settled = _inflation(pool.fits, options), False
        # clutter and the share of the visible points that is detected are those of the best assignment
        for _ in range(2):
            odds = log_odds(task, leader)
            value = pool.values(odds, detected, inflation)
            best = int(value.argmax()) if len(value) else -1
            if best < 0 or value[best] == -np.inf:
                break
            before = leader, detected
            leader, detected = pool.assignments[best], _detected(task, pool.assignments[best])
            settled = detected == before[1] and np.array_equal(leader, before[0])
            if settled:
                break
        if turn == options.rounds or not len(value) or task.deadline.left() <= 0.0:
            break
        highest = float(value.max())
        enough = highest - options.negligible_odds
        near = [number for number in np.argsort(-value, kind="stable").tolist() if value[number] > enough]
        waiting = [number for number in near if number not in visited][: options.searched_per_round]
        if not waiting:
            break
        for number in waiting:
            visited.add(number)
            # where there are many matches a change is known to first order, and fitted only if it is probable; but
            # another pose may have been met with half of its matches, and grows here to its own best assignment
            known_well = _has_many(task, pool.assignments[number], options) and of_one_pose(
                pool.assignments[best], pool.assignments[number]
            )
            worth = highest - options.fitted_odds if known_well else enough
            if value[number] <= worth:
                continue
            known = _known(task, pool, number, (odds, detected, inflation), known)
            for other, gain in _neighbours(known.changes, known.gains, pool.assignments[number], options):
                if value[number] + gain > worth:
                    pool.add(other)
                elif value[number] + gain > enough and number == best:
                    beside.append((other, number, gain))
        if settled and len(pool.assignments) == len(value) and visited.issuperset(near):
            break  # another turn would be the same
    if best < 0 or value[best] == -np.inf:
        return Ranked([], np.empty(0), np.nan, NO_POSE)
    every, values, numbers = list(pool.assignments[: len(value)]), value.tolist(), list(range(len(value)))
    for other, number, gain in beside:
        if pool.holds(other):
            continue
        every.append(other)
        values.append(float(value[number]) + gain)
        numbers.append(number)
    order = sorted(range(len(values)), key=lambda place: (-values[place], every[place].tobytes()))
    order = [place for place in order if values[place] > -np.inf]
    doubt = np.array([pool.fits[numbers[place]][0].doubt for place in order])
    logarithms = (np.array([values[place] for place in order]) - max(values)) / doubt
    if consensus is not None and 1.0 / np.exp(logarithms).sum() < options.agreed:
        (place,) = [rank for rank, place in enumerate(order) if np.array_equal(every[place], consensus)] or [0]
        order.insert(0, order.pop(place))
        logarithms = np.concatenate([logarithms[place : place + 1], np.delete(logarithms, place)])
    number = numbers[order[0]]
    fit, k = pool.fits[number]
    image, sigma = task.image
    density = local_density(image.T, usual_noise(sigma))
    beyond = float(fit.inflated(inflation)[k]) + fit.of_pose(k, density)
    first = every[order[0]]
    beyond += log_odds_against_uniform(task, first)
    known = _known(task, pool, number, (odds, detected, inflation), known)
    every = [every[place] for place in order]
    each = marginals(every, logarithms, known.changes, known.gains, fit.doubt)
    return Ranked(every, logarithms, beyond, _misfit(fit, k, options), each)


def _has_many(task: MatchingTask, assignment: Integers, options: PosteriorOptions) -> bool:
    """Whether an assignment has so many matches that a change hardly moves its pose."""
    return bool(np.count_nonzero(assignment >= 0) >= task.problem.minimal + options.settled_matches)


def misfit(task: MatchingTask, assignment: Integers, options: PosteriorOptions = DEFAULT_OPTIONS) -> Misfit:
    """Misfit of the residuals of an assignment about its best pose."""
    return _misfit(task.problem.fitted(task.points, assignment[None]), 0, options)


def _misfit(fit: Fit, k: int, options: PosteriorOptions) -> Misfit:
    return Misfit.of(float(fit.chi2[k]), max(int(fit.dof[k]), 0), options)


def _detected(task: MatchingTask, assignment: Integers) -> float:
    """Probability that a point is detected: as given, or as estimated from an assignment."""
    if task.options.detection_rate is not None:
        return min(task.options.detection_rate, HIGHEST_RATE)
    return (int(np.count_nonzero(assignment >= 0)) + HALF) / (len(assignment) + 1.0)


def _inflation(fits: list[tuple[RelativeFit, int]], options: PosteriorOptions) -> float:
    """Factor on the given variances that the best fitting assignment asks for; at least 1.

    Only assignments with hardly fewer matches than the first count, because fewer points fit better. It is bounded, so
    that an assignment which no pose fits does not become probable by treating everything as noise.
    """
    least = int(fits[0][0].dof[fits[0][1]]) - options.freedom_slack if fits else 0
    fair = [_misfit(fit, k, options).variances for fit, k in fits if int(fit.dof[k]) >= least]
    return min(max(1.0, min(fair, default=1.0)), options.most_inflation)


class _Known(NamedTuple):
    """Changes of a fitted assignment that are worth considering, and the quantities they depend on."""

    number: int
    odds: NDArray[np.float64]
    detected: float
    inflation: float
    changes: Changes
    gains: NDArray[np.float64]
    """(K,) log-odds of each change against the assignment, to first order."""


_NOTHING_KNOWN = _Known(
    number=-1,
    odds=np.empty(0),
    detected=0.0,
    inflation=1.0,
    changes=Changes(*(np.empty(0, np.int64),) * 4),
    gains=np.empty(0),
)


def _known(
    task: MatchingTask,
    pool: FittedPool,
    number: int,
    given: tuple[NDArray[np.float64], float, float],
    before: _Known,
) -> _Known:
    """The changes of a fitted assignment, given odds, the probability of a detection and the inflation."""
    odds, detected, inflation = given
    if before.number == number and before[2:4] == given[1:] and np.array_equal(before.odds, odds):
        return before
    assignment, (fit, k) = pool.assignments[number], pool.fits[number]
    gains = fit.densities(k, inflation) + odds + (math.log(detected) - math.log1p(-detected))
    matched = np.flatnonzero(assignment >= 0)
    own = gains[matched, assignment[matched]]
    gains[matched, assignment[matched]] = np.where(np.isfinite(own), own, IMPOSSIBLE)
    return _Known(number, *given, *likely_changes(assignment, gains, -OUT_OF_THE_QUESTION * fit.doubt))


def _neighbours(
    changes: Changes, change: NDArray[np.float64], assignment: Integers, options: PosteriorOptions
) -> list[tuple[Integers, float]]:
    """The most probable changes of an assignment, and their log-odds against it to first order."""
    (chosen,) = (change > -options.neighbour_odds).nonzero()
    if not len(chosen):
        return []
    chosen = chosen[np.argsort(-change[chosen], kind="stable")[: options.neighbours]]
    return list(zip(changes.take(chosen).applied_to(assignment), change[chosen].tolist(), strict=True))

"""Posterior probability of assignments: each is fitted by one pose, and their neighbours are searched as well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.neighbourhood import one_change_neighbours
from rootmatch.options import Options, option
from rootmatch.pipeline.task import MatchingTask
from rootmatch.problems.pose_fit.base import Fit
from rootmatch.samplers.clutter import CROWDING

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class PosteriorOptions(Options):
    """How far the neighbourhoods of assignments are searched, and how much a given σ is trusted."""

    negligible_odds: float = option(6.0, above=0.0)
    """Log-odds against an assignment at which it is dropped: e⁻⁶ is 0.25 %. A round value, not tuned."""
    neighbour_odds: float = option(12.0, above=0.0)
    """Log-odds, to first order, at which a change is not even fitted: twice `negligible_odds`, as a new pose may gain
    as much again. Not tuned."""
    noise_freedom: float = option(20.0, above=0.0)
    """Degrees of freedom that the given σ counts for when the residuals say that it is larger. A round value; its
    effect is measured in benchmarks/accuracy.py and benchmarks/reliability.py."""
    freedom_slack: int = option(2, least=0)
    """Degrees of freedom that an assignment may lack and still estimate σ: one point. By construction."""
    rounds: int = option(4, least=0)
    """Rounds of neighbourhood search. A round value, not tuned."""
    searched_per_round: int = option(6, least=1)
    """Assignments whose neighbours are fitted in each round. A round value, not tuned."""
    neighbours: int = option(32, least=1)
    """Most probable changes of one assignment that are fitted. A round value, not tuned."""


DEFAULT_OPTIONS = PosteriorOptions()
HALF = 0.5
"""A count is estimated as (k + ½) / (n + 1) (Krichevsky and Trofimov 1981), so that no probability is 0 or 1."""
IMPOSSIBLE = -1e9
"""Log-odds in the place of −∞, so that differences stay numbers."""


def log_odds(task: MatchingTask, assignment: Integers) -> NDArray[np.float64]:
    """Log prior odds of each correspondence (n, n') against clutter, times pixel².

    A source point is visible as often as those of ``assignment`` are; clutter is as dense as the detections it leaves.
    """
    n, n_target = task.shape
    matched = int((assignment >= 0).sum())
    density = CROWDING * (n_target - matched + HALF) / _area(task)
    visible = (matched + HALF) / (n + 1.0)
    odds = np.full((n, n_target), np.log(visible / (1.0 - visible)) - np.log(density))
    if task.prior is not None:
        with np.errstate(divide="ignore"):
            odds += np.log(task.prior / max(float(task.prior.max(initial=0.0)), 1e-300))
    if task.allowed is not None:
        odds[~task.allowed] = -np.inf
    return odds


def log_odds_against_clutter(task: MatchingTask, assignment: Integers) -> float:
    """Log-odds of an assignment's clutter and invisible points against the hypothesis that all is clutter."""
    n, n_target = task.shape
    matched = int((assignment >= 0).sum())
    visible, left, area = (matched + HALF) / (n + 1.0), n_target - matched, _area(task)
    # two Poisson processes, each with the density estimated from its own count
    clutter = left * np.log((left + HALF) / area) - n_target * np.log(n_target / area)
    return float(matched * np.log(visible) + (n - matched) * np.log(1.0 - visible) + clutter + matched - HALF)


def _area(task: MatchingTask) -> float:
    """Area of the image in pixel²: the bounding box of n' uniform points, corrected for being too small."""
    n_target = task.shape[1]
    return max(float(np.prod(np.ptp(task.points.target, axis=0))) * ((n_target + 1) / (n_target - 1)) ** 2, 1e-300)


@dataclass(frozen=True)
class Ranked:
    """Assignments, the most probable first.

    Attributes
    ----------
    assignments : list of (n,) int64 arrays
    logarithms : (K,) array
        Log-odds of each against the first.
    """

    assignments: list[Integers]
    logarithms: NDArray[np.float64]
    beyond_chance: float
    """Log-odds of the first assignment against none, all detections clutter; NaN where unknown."""

    @property
    def probability(self) -> float:
        """Posterior probability of the first assignment, given that one of them is right."""
        return self.probability_of(1)

    def probability_of_assignment(self, assignment: Integers) -> float:
        """Posterior probability of one of the assignments, 0 where it is none of them."""
        shares = np.exp(self.logarithms)
        same = [np.array_equal(other, assignment) for other in self.assignments]
        return float(shares[same].sum() / shares.sum())

    def probability_of(self, count: int) -> float:
        """Posterior probability that the right assignment is among the first ``count``."""
        shares = np.exp(self.logarithms)
        return float(shares[:count].sum() / shares.sum())


def ranked(task: MatchingTask, assignments: list[Integers], options: PosteriorOptions = DEFAULT_OPTIONS) -> Ranked:
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
    """
    least = task.problem.minimal + 1
    odds = log_odds(task, assignments[0])
    pool = {assignment.tobytes(): assignment for assignment in assignments if (assignment >= 0).sum() >= least}
    fits: dict[bytes, tuple[Fit, int]] = {}
    value: dict[bytes, float] = {}
    visited: set[bytes] = set()
    for turn in range(options.rounds + 1):
        fits |= _fits(task, [key for key in pool if key not in fits], pool)
        inflation = _inflation(fits, options)
        for key, (fit, k) in fits.items():
            matched = np.flatnonzero(pool[key] >= 0)
            total = float(fit.inflated(inflation)[k] + odds[matched, pool[key][matched]].sum())
            value[key] = total if np.isfinite(total) else -np.inf
        if turn == options.rounds or not value:
            break
        enough = max(value.values()) - options.negligible_odds
        near = [key for key in sorted(value, key=lambda key: -value[key]) if value[key] > enough]
        waiting = [key for key in near if key not in visited][: options.searched_per_round]
        if not waiting:
            break
        for key in waiting:
            visited.add(key)
            fit, k = fits[key]
            gains = odds + fit.densities(k, inflation)
            if task.points.normals is not None:
                gains[(pool[key] < 0) & fit.invisible(k, task.points.normals)] = -np.inf
            for other, gain in _neighbours(gains, pool[key], options):
                if value[key] + gain > enough and (other >= 0).sum() >= least:
                    pool.setdefault(other.tobytes(), other)
    order = sorted(value, key=lambda key: (-value[key], key))
    order = [key for key in order if value[key] > -np.inf]
    logarithms = np.array([(value[key] - value[order[0]]) / fits[key][0].doubt for key in order])
    if not order:
        return Ranked([], logarithms, np.nan)
    fit, k = fits[order[0]]
    beyond = float(fit.inflated(inflation)[k]) + fit.of_pose() + log_odds_against_clutter(task, pool[order[0]])
    return Ranked([pool[key] for key in order], logarithms, beyond)


def _fits(task: MatchingTask, keys: list[bytes], pool: dict[bytes, Integers]) -> dict[bytes, tuple[Fit, int]]:
    """Pose fits of some assignments of the pool, and their rows in them."""
    if not keys:
        return {}
    assignments = np.array([pool[key] for key in keys])
    fit = task.problem.fitted(task.points, assignments)
    return {key: (fit, k) for k, key in enumerate(keys)}


def _inflation(fits: dict[bytes, tuple[Fit, int]], options: PosteriorOptions) -> float:
    """Factor on the given variances that the best fitting assignment asks for; at least 1.

    Only assignments count that match hardly fewer points than the first: the fewer, the better they fit.
    """
    found = [(float(fit.chi2[k]), int(fit.freedom[k])) for fit, k in fits.values()]
    given = options.noise_freedom
    fair = [
        (given + chi2) / (given + freedom) for chi2, freedom in found if freedom >= found[0][1] - options.freedom_slack
    ]
    return max(1.0, min(fair, default=1.0)) if np.isfinite(min(fair, default=1.0)) else 1.0


def _neighbours(
    gains: NDArray[np.float64], assignment: Integers, options: PosteriorOptions
) -> list[tuple[Integers, float]]:
    """The most probable changes of an assignment, and their log-odds against it to first order.

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
    chosen = np.flatnonzero(change > -options.neighbour_odds)
    chosen = chosen[np.argsort(-change[chosen], kind="stable")[: options.neighbours]]
    return list(zip(changes.take(chosen).applied_to(assignment), change[chosen].tolist(), strict=True))

"""Odds of detections against clutter, before and after a fit, and the options of the posterior that uses them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.task import MatchingTask
from rootmatch.options import Options, option
from rootmatch.samplers.clutter import CROWDING

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class PosteriorOptions(Options):
    """Extent of the neighbourhood search of assignments, and trust in the stated σ."""

    negligible_odds: float = option(6.0, above=0.0)
    """Log-odds against an assignment at which it is dropped: e⁻⁶ is 0.25 %. A round value, not tuned."""
    neighbour_odds: float = option(12.0, above=0.0)
    """Log-odds, to first order, at which a change is not even fitted: twice `negligible_odds`, as a new pose may gain
    as much again. Not tuned."""
    most_inflation: float = option(4.0, least=1.0)
    """Largest factor on the stated variances: if the best fit asks for more than twice the stated σ, the assignment is
    not trusted. A round value; it rejects the unrelated points of benchmarks/constellations.py."""
    noise_freedom: float = option(20.0, above=0.0)
    """Degrees of freedom that the given σ counts for when the residuals say that it is larger. A round value; its
    effect is measured in benchmarks/accuracy.py and benchmarks/reliability.py."""
    agreed: float = option(0.5, least=0.0, most=1.0)
    """Probability below which, instead of an assignment that is more likely wrong than right, the one with the most
    matches expected to be right is reported. The gain: benchmarks/two_views.py."""
    freedom_slack: int = option(2, least=0)
    """Degrees of freedom that an assignment may lack and still estimate σ: one point. By construction."""
    rounds: int = option(4, least=0)
    """Rounds of neighbourhood search. A round value, not tuned."""
    searched_per_round: int = option(6, least=1)
    """Assignments whose neighbours are fitted in each round. A round value, not tuned."""
    settled_matches: int = option(6, least=1)
    """Matches beyond a minimal set from which the neighbours of the best assignment are known to first order: a
    detection's density about its prediction by the other points is what it adds to their evidence. A round value."""
    fitted_odds: float = option(4.0, above=0.0)
    """Log-odds against the best assignment up to which a change of one with so many matches is fitted, and its own
    changes are looked at; the others count to first order. A round value; what it changes: benchmarks/record.py and
    benchmarks/constellations.py."""
    neighbours: int = option(32, least=1)
    """Most probable changes of one assignment that are fitted. A round value, not tuned."""


DEFAULT_OPTIONS = PosteriorOptions()
HALF = 0.5
"""A count is estimated as (k + ½) / (n + 1) (Krichevsky and Trofimov 1981), so that no probability is 0 or 1."""


def log_odds(task: MatchingTask, assignment: Integers) -> NDArray[np.float64]:
    """Log prior odds of each correspondence (n, n') of a detected point against clutter, times pixel².

    The density of clutter is that of the detections which ``assignment`` leaves.
    """
    n, n_target = task.shape
    matched = int(np.count_nonzero(assignment >= 0))
    density = CROWDING * (n_target - matched + HALF) / task.image_area
    odds = np.full((n, n_target), -np.log(density))
    if task.weights is not None:
        odds += candidate_log_odds(task)
    if task.allowed is not None:
        odds[~task.allowed] = -np.inf
    return odds


def candidate_log_odds(task: MatchingTask) -> NDArray[np.float64]:
    """Logarithms (n, n') of the weights of candidates over the largest; zero where none are given."""
    if task.weights is None:
        return np.zeros(task.shape)
    with np.errstate(divide="ignore"):
        logarithms = np.log(task.weights)
        return np.asarray(logarithms - logarithms.max(initial=-math.inf))


def log_odds_against_uniform(task: MatchingTask, assignment: Integers) -> float:
    """Log-odds of an assignment's clutter and invisible points against all being clutter, uniform in the image."""
    n, n_target = task.shape
    matched = int((assignment >= 0).sum())
    visible, left, area = (matched + HALF) / (n + 1.0), n_target - matched, task.image_area
    # two Poisson processes, each with the density estimated from its own count
    clutter = left * np.log((left + HALF) / area) - n_target * np.log(n_target / area)
    return float(matched * np.log(visible) + (n - matched) * np.log(1.0 - visible) + clutter + matched - HALF)

"""Odds of detections against clutter, prior to and after a fit, and the options of the posterior they enter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.task import MatchingTask
from rootmatch.options import Options, option
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
    most_inflation: float = option(4.0, least=1.0)
    """Largest factor on the given variances: where the best fit asks for more than twice the given σ, the assignment is
    not believed. A round value; what it refuses: the unrelated points of benchmarks/constellations.py."""
    fully_visible: float = option(0.5, above=0.0, most=1.0)
    """Cosine between a normal and the direction to the camera up to which a point is as visible as from its front;
    beyond, light falls with the cosine (Lambert). A round value, not tuned."""
    barely_visible: float = option(0.02, above=0.0, most=1.0)
    """How visible a point is, over that, as seen from the side or from behind: normals are not exact. Not tuned."""
    view_edge: float = option(0.1, above=0.0)
    """Width of the edge of a given view angle, in cosines, over which a point fades: poses and normals are not exact.
    Five degrees at 70°. A round value."""
    detected: tuple[float, ...] = option((0.95, 0.6, 0.25, 0.1), above=0.0, most=1.0)
    """Probabilities that a visible point is detected, over which the odds against clutter alone are averaged. Round
    values, as in `VerificationOptions`."""
    noise_freedom: float = option(20.0, above=0.0)
    """Degrees of freedom that the given σ counts for when the residuals say that it is larger. A round value; its
    effect is measured in benchmarks/accuracy.py and benchmarks/reliability.py."""
    agreed: float = option(0.5, least=0.0, most=1.0)
    """Probability of an assignment below which the one with the most matches expected to be right is reported instead:
    from where it is more probably wrong than right. What that gains: benchmarks/two_views.py."""
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
MOST_DETECTED = 0.999
"""Of a detection rate: beyond, one hidden point would refute a pose."""


def log_odds(task: MatchingTask, assignment: Integers) -> NDArray[np.float64]:
    """Log prior odds of each correspondence (n, n') of a detected point against clutter, times pixel².

    Clutter is as dense as the detections that ``assignment`` leaves.
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


def visibility(task: MatchingTask, fit: Fit, k: int, options: PosteriorOptions) -> NDArray[np.float64]:
    """How visible each source point (n,) is in the pose of assignment k, up to 1."""
    if task.points.normals is None:
        return np.ones(task.shape[0])
    cosine = np.nan_to_num(fit.facing(k, task.points.normals), nan=0.0)
    if task.points.view_cosine is not None:
        within = (cosine - task.points.view_cosine) / options.view_edge + HALF
        unknown = ~task.points.normals.any(axis=1)
        return np.where(unknown, 1.0, np.clip(within, options.barely_visible, 1.0))
    return np.clip(cosine / options.fully_visible, options.barely_visible, 1.0)


def log_odds_against_clutter(
    assignment: Integers,
    visible: NDArray[np.float64],
    density: NDArray[np.float64],
    options: PosteriorOptions,
    detection: float | None = None,
) -> float:
    """Log-odds of an assignment's matched and unmatched points against the hypothesis that all is clutter.

    Clutter is as dense about each detection as detections are there (``density``, the matched ones among them): that
    detections crowd is no evidence for a pose. How often a visible point is detected is averaged over, unless it is
    given (``detection``).
    """
    matched = assignment >= 0
    rates = options.detected if detection is None else (min(detection, MOST_DETECTED),)
    chance = np.array(rates)[:, None] * visible
    detected = np.where(matched, np.log(chance), np.log1p(-chance)).sum(axis=1)
    clutter = float(np.log(CROWDING * density[assignment[matched]]).sum())
    return float(np.logaddexp.reduce(detected)) - math.log(len(detected)) - clutter


def log_odds_against_uniform(task: MatchingTask, assignment: Integers) -> float:
    """Log-odds of an assignment's clutter and invisible points against all being clutter, uniform in the image."""
    n, n_target = task.shape
    matched = int((assignment >= 0).sum())
    visible, left, area = (matched + HALF) / (n + 1.0), n_target - matched, task.image_area
    # two Poisson processes, each with the density estimated from its own count
    clutter = left * np.log((left + HALF) / area) - n_target * np.log(n_target / area)
    return float(matched * np.log(visible) + (n - matched) * np.log(1.0 - visible) + clutter + matched - HALF)

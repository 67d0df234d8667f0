"""σ of the image from the points themselves: match with a guess, look at the residuals inside the answer, again."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends import cpu
from rootmatch.hypergraph.affinity import Residual
from rootmatch.hypergraph.enumeration import wide_first
from rootmatch.problems.base import Problem

FIRST_GUESS = 0.004
"""σ of the first match over the diagonal of the image points: 2 pixels of 500."""
CUT = 9.0
"""Squared residual beyond which all count alike."""
MEAN_CUT = {1: 0.9950, 2: 1.9778}
"""Mean of min(χ², CUT) by degrees of freedom."""
WITHIN = 1.5
"""Factor within which σ is to be as often as possible."""
CENTRE = 4.0 * math.log(WITHIN) / (WITHIN**2 - WITHIN**-2)
"""Of χ² over its degrees of freedom, for that: 0.90, whatever they are, as F(c k² ν) − F(c ν / k²) is largest there."""
SUBSETS = 2000
"""Hyper-edges of one motion that are looked at, at most."""
SETTLED, ROUNDS = 1.15, 5
"""Factor by which a guess may be off, and matches at most."""
LEAST = 1e-3
"""Least σ over the first guess: exact data have none."""


class Matched(Protocol):
    """What is needed of a `rootmatch.match.Match`, which is made above this layer."""

    @property
    def source(self) -> NDArray[np.float64]: ...  # noqa: D102

    @property
    def target(self) -> NDArray[np.float64]: ...  # noqa: D102

    @property
    def problem(self) -> Problem: ...  # noqa: D102

    @property
    def noise(self) -> Any: ...  # noqa: D102

    @property
    def assignment(self) -> NDArray[np.int64]: ...  # noqa: D102

    @property
    def motions(self) -> NDArray[np.int64]: ...  # noqa: D102

    @property
    def alternatives(self) -> list[tuple[NDArray[np.int64], float]]: ...  # noqa: D102


Result = TypeVar("Result", bound=Matched)


def with_estimated_noise(attempt: Callable[[float], Result]) -> Result:
    """The match at the σ that it bears out itself.

    Parameters
    ----------
    attempt : callable
        The match at a given σ.
    """
    match = attempt(math.nan)
    guess = first = match.noise
    for _ in range(ROUNDS):
        sigma = estimated(match)
        if math.isnan(sigma) or max(sigma / guess, guess / sigma) < SETTLED:
            break
        guess = min(max(sigma, LEAST * first), 4.0 * first)
        match = attempt(guess)
    return match


def first_guess(target: NDArray[np.float64]) -> float:
    """A generous σ for points (n', 2) of which nothing is known."""
    return FIRST_GUESS * float(np.hypot(*np.ptp(target, axis=0)))


def estimated(match: Matched) -> float:
    """σ in pixels from the residuals inside an answer, NaN where there is none.

    By χ² of the points of each motion about their best pose, where the problem fits answers. Else it is the scale at
    which the squared residuals of the hyper-edges among them, cut off at 9, have the mean of their law.
    """
    problem, order = match.problem, match.problem.order
    squares, freedom = [], []
    labels = range(int(match.motions.max(initial=-1)) + 1)
    groups = [np.flatnonzero((match.motions == label) & (match.assignment >= 0)) for label in labels]
    for members in groups:
        if len(members) <= order:
            continue
        scale = _scale(problem, match, members)
        if math.isfinite(scale):
            squares.append(scale * (len(members) - problem.minimal))
            freedom.append(len(members) - problem.minimal)
    if not freedom:
        return math.nan
    return float(match.noise) * math.sqrt(sum(squares) / sum(freedom))


def _scale(problem: Problem, match: Matched, members: NDArray[np.int64]) -> float:
    """Square of the true σ over the assumed one, by one group."""
    if problem.fits_answers:
        alone = np.full_like(match.assignment, -1)
        alone[members] = match.assignment[members]
        answers = [alone]
        if len(members) == (match.assignment >= 0).sum():
            # with σ far too large a wrong answer can seem to be as good as the right one, which fits far better
            others = [other for other, _ in match.alternatives if (other >= 0).sum() >= len(members)]
            answers += others
        fit = problem.fitted(match.source, match.target, match.noise, np.array(answers))
        scale = np.maximum(fit.chi2 / fit.freedom, LEAST**2)
        worth = [float(fit.inflated(scale[k])[k]) for k in range(len(answers))]
        return float(scale[int(np.argmax(worth))]) / CENTRE
    points, pixels = match.source[members], match.target[match.assignment[members]]
    turned = wide_first(points)
    tables = problem.prepare(points[turned], pixels[turned], match.noise)
    rng = np.random.default_rng(0)
    chosen = np.sort(np.argsort(rng.random((SUBSETS, len(members))), axis=1)[:, : problem.order], axis=1)
    residuals = cpu.residuals(tables, Residual("joint").kernel_kind(problem.pair_count), chosen, chosen)
    return scale_of(residuals**2, MEAN_CUT[problem.constraints])


def scale_of(squared: NDArray[np.float64], mean: float) -> float:
    """The s with mean(min(squared / s, CUT)) = mean, by bisection."""
    low, high = 1e-12, 1e12
    for _ in range(100):
        middle = math.sqrt(low * high)
        if float(np.minimum(squared / middle, CUT).mean()) > mean:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)

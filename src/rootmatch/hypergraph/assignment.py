"""From a soft assignment to a discrete one, with points that have no image."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.deadline import checkpoint
from rootmatch.errors import InputError

SECONDS_PER_ENTRY = 2e-8
"""Time that one entry takes when it is checked whether a soft assignment is clear."""
SECONDS_PER_STEP = 1e-8
"""Time that a step of the Hungarian method takes. It makes n² n' steps at most, as it does if the rank is 1."""


def apart_from(assignments: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which assignments (K, n) share no target with another one (n,)."""
    return np.asarray(~np.isin(assignments, other[other >= 0]).any(axis=1))


def discretise(soft: ArrayLike) -> NDArray[np.int64]:
    """One-to-one assignment of the largest total soft value (Hungarian method).

    Parameters
    ----------
    soft : (n, n') float
        Non-negative; an entry of 0 means that nothing supports the pair.

    Returns
    -------
    (n,) int64
        Target of each source point; −1 for those left over when n > n', and for those that would get a value of 0.

    Raises
    ------
    InputError
        If `soft` is not a finite, non-negative matrix.
    """
    value = np.asarray(soft, dtype=np.float64)
    checkpoint(SECONDS_PER_ENTRY * value.size)
    if value.ndim != 2 or not np.all((value >= 0) & np.isfinite(value)):
        raise InputError(f"soft: expected a matrix of finite values ≥ 0, got shape {value.shape} or other values")
    # A common scale changes nothing, and keeps sums of huge values finite.
    largest = value.max(initial=0.0)
    source, target = _largest_total(value / largest if largest > 0 else value)
    assignment = np.full(value.shape[0], -1, np.int64)
    evident = value[source, target] > 0
    assignment[source[evident]] = target[evident]
    return assignment


def _largest_total(value: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the one-to-one selection with the largest total."""
    wide = value.shape[0] <= value.shape[1]
    lines = value if wide else value.T
    if value.size:
        best = lines.argmax(axis=1)
        # Where the largest entries of all lines are unique and do not collide, there is nothing to solve.
        alone = np.count_nonzero(lines == lines.max(axis=1, keepdims=True)) == len(lines)
        if alone and np.unique(best).size == best.size:
            every = np.arange(len(lines))
            return (every, best) if wide else (best, every)
    from scipy.optimize import linear_sum_assignment  # slow to import, and a clear case has no need of it

    checkpoint(SECONDS_PER_STEP * lines.size * len(lines))
    rows, columns = linear_sum_assignment(value, maximize=True)
    return rows, columns


def one_hot(assignment: NDArray[np.int64], n_target: int) -> NDArray[np.float64]:
    """Binary matrix (n, n') of an assignment (n,)."""
    x = np.zeros((assignment.size, n_target))
    matched = np.flatnonzero(assignment >= 0)
    x[matched, assignment[matched]] = 1.0
    return x


def margin(
    score: float, alternatives: list[tuple[NDArray[np.int64], float]], points: NDArray[np.int64] | None = None
) -> float:
    """Lead of an assignment over the best different one: 1 − second / best; 0 for a tie, 1 when nothing else scores.

    Parameters
    ----------
    score : float
        Of the assignment.
    alternatives : list of ((n,) int64, float)
        Other assignments and their scores, in any order.
    points : (n,) int64, optional
        The assignment with −1 at points that are not claimed: an alternative that differs at none of the claimed
        points, or only leaves some of them out, is not different.
    """
    second = 0.0
    for other, value in alternatives:
        if points is None or np.any((points >= 0) & (other >= 0) & (points != other)):
            second = max(second, value)
    return min(1.0, max(0.0, 1.0 - second / score)) if score > 0 else 0.0

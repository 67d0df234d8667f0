"""From a soft assignment to a discrete one, with points that have no image."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.deadline import checkpoint
from rootmatch.errors import InputError
from rootmatch.jit.decorators import driver

SECONDS_PER_ENTRY = 2e-8
"""Time that one entry takes when it is checked whether a soft assignment is clear."""
SECONDS_PER_STEP = 1e-8
"""Time that a step of the Hungarian method takes. It makes n² n' steps at most, as it does if the rank is 1."""
INVALID, UNCLEAR, CLEAR = 0, 1, 2
"""What `assign_clear` says of a soft assignment."""


def check_assignment(assignment: ArrayLike, shape: tuple[int, int]) -> NDArray[np.int64]:
    """An assignment (n,) of a caller between n and n' points: each target once at most, −1 where unmatched."""
    try:
        array = np.asarray(assignment)
    except ValueError:  # rows of several lengths
        array = np.empty(0)
    n, n_target = shape
    if array.shape != (n,) or not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"assignment: {array.dtype} of shape {array.shape} given, integers of shape ({n},) expected")
    if array.min(initial=0) < -1 or array.max(initial=-1) >= n_target:
        raise InputError(f"assignment: {array.min()} to {array.max()} given; give −1, or 0 to {n_target - 1}")
    matched = array[array >= 0]
    if np.unique(matched).size < matched.size:
        raise InputError("assignment: a target point is matched twice; match each at most once")
    return np.asarray(array, dtype=np.int64)


def are_targets_disjoint(assignments: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which assignments (K, n) share no target with another one (n,)."""
    taken = np.zeros(max(int(assignments.max(initial=-1)), int(other.max(initial=-1))) + 2, np.bool_)
    taken[other] = True
    taken[-1] = False  # the place of −1
    return np.asarray(~taken[assignments].any(axis=1))


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
    assignment = np.full(len(value) if value.ndim else 0, -1, np.int64)
    found = INVALID
    if value.ndim == 2:
        found = assign_clear(np.ascontiguousarray(value), assignment, np.zeros(max(value.shape), np.bool_))
    if found == INVALID:
        raise InputError(f"soft: expected a matrix of finite values ≥ 0, got shape {value.shape} or other values")
    if found == UNCLEAR:
        checkpoint(SECONDS_PER_STEP * value.size * min(value.shape))
        # A common scale changes nothing, and keeps sums of huge values finite.
        largest = value.max(initial=0.0)
        return maximise_total(value / largest if largest > 0 else value, 0.0)
    return assignment


@driver(nogil=True)
def assign_clear(soft, assignment, taken):  # type: ignore[no-untyped-def]
    """Fill in the assignment (n,) of a soft one (n, n') if that is `CLEAR`; return which of the three it is.

    It is clear if the largest entry of each row (with n > n', of each column) is unique, and no two of these share a
    column (a row). It is `INVALID` if an entry is negative or not finite. ``taken``, as long as the larger set, is
    False at first.
    """
    n, n_target = soft.shape
    for i in range(n):
        assignment[i] = -1
        for k in range(n_target):
            if not 0.0 <= soft[i, k] < math.inf:
                return INVALID
    wide = n <= n_target
    for line in range(min(n, n_target)):
        best, largest, ties = 0, -1.0, 0
        for place in range(max(n, n_target)):
            value = soft[line, place] if wide else soft[place, line]
            if value > largest:
                best, largest, ties = place, value, 0
            ties += value == largest
        if ties != 1 or taken[best]:
            return UNCLEAR
        taken[best] = True
        if largest > 0.0:
            if wide:
                assignment[line] = best
            else:
                assignment[best] = line
    return CLEAR


def maximise_total(value: NDArray[np.float64], above: float | NDArray[np.float64] = -np.inf) -> NDArray[np.int64]:
    """The one-to-one assignment (n,) with the largest total of values (n, n'), of the pairs ``above`` some value.

    ``above`` may differ from row to row, (n,).
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and a clear case has no need of it

    rows, columns = linear_sum_assignment(value, maximize=True)
    good = value[rows, columns] > np.broadcast_to(above, len(value))[rows]
    assignment = np.full(len(value), -1, np.int64)
    assignment[rows[good]] = columns[good]
    return assignment


def one_hot(assignment: NDArray[np.int64], n_target: int) -> NDArray[np.float64]:
    """Binary matrix (n, n') of an assignment (n,)."""
    x = np.zeros((assignment.size, n_target))
    matched = np.flatnonzero(assignment >= 0)
    x[matched, assignment[matched]] = 1.0
    return x


def margin(
    score: float, alternatives: list[tuple[NDArray[np.int64], float]], points: NDArray[np.int64] | None = None
) -> float:
    """Lead of an assignment over the best different one: 1 − second / best, 1 when nothing else scores.

    It is 0 for a tie, and where another one scores more, as may be found beside what an iteration ends with.

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

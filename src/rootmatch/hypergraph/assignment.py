"""From a soft assignment to a discrete one, with points that have no image."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor


def discretise(soft: ArrayLike) -> NDArray[np.int64]:
    """One-to-one assignment of the largest total soft value (Hungarian method).

    Parameters
    ----------
    soft : (n, n') float
        Non-negative; an entry of 0 means that nothing speaks for the pair.

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
    """Rows and columns of the one-to-one choice of the largest total."""
    wide = value.shape[0] <= value.shape[1]
    lines = value if wide else value.T
    if value.size:
        best = lines.argmax(axis=1)
        # Where each line can have what it likes best, and likes one thing best, there is nothing to solve.
        alone = np.count_nonzero(lines == lines.max(axis=1, keepdims=True)) == len(lines)
        if alone and np.unique(best).size == best.size:
            every = np.arange(len(lines))
            return (every, best) if wide else (best, every)
    from scipy.optimize import linear_sum_assignment  # slow to import, and a clear case has no need of it

    rows, columns = linear_sum_assignment(value, maximize=True)
    return rows, columns


def one_hot(assignment: NDArray[np.int64], n_target: int) -> NDArray[np.float64]:
    """Binary matrix (n, n') of an assignment (n,)."""
    x = np.zeros((assignment.size, n_target))
    matched = np.flatnonzero(assignment >= 0)
    x[matched, assignment[matched]] = 1.0
    return x


def gains(assignment: NDArray[np.int64], tensor: AffinityTensor) -> NDArray[np.float64]:
    """What each matched point contributes to the score, (n,): the weights of the hyper-edges inside that contain it.

    0 for unmatched points. Each hyper-edge is counted at all of its d points.
    """
    v = tensor.contract(one_hot(assignment, tensor.shape[1]))
    matched = assignment >= 0
    return np.where(matched, v[np.arange(assignment.size), assignment], 0.0)


def drop_unsupported(assignment: ArrayLike, tensor: AffinityTensor, fraction: float = 0.2) -> NDArray[np.int64]:
    """Unmatch the points that the others do not support.

    A matched point is kept when its gain (see `gains`) is positive and at least `fraction` of the median gain of the
    matched points. Gains shrink as points go, so this is repeated until nothing changes; the median is over what is
    left, so that a few dropped points do not make the rest look good.

    Parameters
    ----------
    assignment : (n,) int
        −1 where unmatched.
    tensor : AffinityTensor
        Its hyper-edges give the gains.
    fraction : float
        0 keeps every point with any support; 1 would keep the better half only.

    Returns
    -------
    (n,) int64
        The assignment with −1 for points without support.
    """
    if not 0 <= fraction <= 1:
        raise InputError(f"fraction: got {fraction}; expected 0 … 1")
    # Only hyper-edges inside the assignment count, and fewer of them as points go.
    inside = tensor.inside(assignment)
    kept = np.array(assignment, dtype=np.int64)
    while (matched := kept >= 0).any():
        gain = gains(kept, inside)
        weak = matched & ((gain < fraction * np.median(gain[matched])) | (gain <= 0))
        if not weak.any():
            break
        kept[weak] = -1
    return kept


def margin(
    score: float, alternatives: list[tuple[NDArray[np.int64], float]], points: NDArray[np.int64] | None = None
) -> float:
    """Lead of an answer over the best different one: 1 − second / best, 0 for a tie, 1 when nothing else scores.

    Parameters
    ----------
    score : float
        Of the answer.
    alternatives : list of ((n,) int64, float)
        Other assignments and their scores, in any order.
    points : (n,) int64, optional
        The answer with −1 at points that are not claimed: an alternative that differs at none of the claimed points,
        or only leaves some of them out, is not different.
    """
    second = 0.0
    for other, value in alternatives:
        if points is None or np.any((points >= 0) & (other >= 0) & (points != other)):
            second = max(second, value)
    return min(1.0, max(0.0, 1.0 - second / score)) if score > 0 else 0.0

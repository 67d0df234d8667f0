"""Confidence: the posterior probability that each point's match is right or, if unmatched, that it has none.

A posterior over whole assignments says little about large ones: with fifty points, thousands of assignments differ in
one doubtful point, and each has a small share. So local changes, which leave the pose as it is, are summed point by
point, as if they were independent of each other, and only assignments of another pose compete as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.neighbourhood import Changes

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

POSE = 0.9
"""Least probability of a pose that counts as certain: that of a matched assignment."""
SHARED = 0.5
"""Fraction of its matches that an assignment of the same pose has in common with the most probable one; assignments of
another pose, or of a symmetric relabelling, have hardly any. A round value, not tuned."""
FITTED = 256
"""Number of local changes whose own fit is looked up, the most probable ones; the others count to first order. It
changes hardly anything."""


@dataclass(frozen=True)
class Marginals:
    """Posterior of the points of the most probable assignment, one by one."""

    each: Floats
    """(n,) posterior probability that the point's match, or its being unmatched, is right."""
    unmatched: Floats
    """(n,) posterior probability that the point is unmatched."""
    pose: float
    """Posterior probability of the pose, whatever its matches: no other pose, nor a symmetric relabelling."""

    def without_unsure(self, assignment: Integers, least: float, doubt: float) -> Integers | None:
        """The assignment without its least certain matches, so that few of the remaining ones are wrong.

        Parameters
        ----------
        assignment : (n,) int64 array
        least : float
            Matches that have to be left.
        doubt : float
            Expected number of wrong matches among those that are left.

        Returns
        -------
        (n,) int64 array or None
            None if the pose is not certain, or if fewer than ``least`` matches remain.
        """
        matched = np.flatnonzero(assignment >= 0)
        order = matched[np.argsort(-self.each[matched], kind="stable")]
        kept = order[np.cumsum(1.0 - self.each[order]) <= doubt]
        if self.pose < POSE or len(kept) < least:
            return None
        sure = np.full_like(assignment, -1)
        sure[kept] = assignment[kept]
        return sure


def of_one_pose(first: Integers, others: Integers) -> NDArray[np.bool_]:
    """Whether other assignments (..., n) share so many matches with the first (n,) that their pose is the same."""
    agree = ((others == first) & (first >= 0)).sum(axis=-1)
    return np.asarray(agree >= SHARED * max(int((first >= 0).sum()), 1))


def marginals(
    assignments: list[Integers], logarithms: Floats, changes: Changes, gains: Floats, doubt: float
) -> Marginals:
    """Marginals of the first of some assignments.

    Parameters
    ----------
    assignments : list of (n,) int64 arrays
        The most probable one first.
    logarithms : (K,) array
        Log-odds of each against the first.
    changes : Changes
        Local changes of the first one.
    gains : (C,) array
        Log-odds of each change to first order.
    doubt : float
        Factor by which those are too large; see `rootmatch.problems.pose_fit.relative.RelativeFit`.
    """
    first = assignments[0]
    odds = gains / doubt
    if len(assignments) > 1:
        strong = np.argsort(-odds, kind="stable")[:FITTED]
        relative = (logarithms - logarithms[0]).tolist()
        known = {assignment.tobytes(): value for assignment, value in zip(assignments, relative, strict=True)}
        for number, changed in zip(strong, changes.take(strong).applied_to(first), strict=True):
            odds[number] = known.get(changed.tobytes(), odds[number])
    weights = np.exp(np.minimum(odds, 0.0))
    second = changes.other >= 0
    total = np.bincount(changes.source, weights, len(first))
    total += np.bincount(changes.other[second], weights[second], len(first))
    away = changes.target < 0
    none = np.bincount(changes.source[away], weights[away], len(first))
    local: Floats = np.asarray(1.0 / (1.0 + total))
    none = np.where(first < 0, 1.0, none) / (1.0 + total)

    if len(assignments) == 1:
        return Marginals(local, np.asarray(none), 1.0)
    every = np.array(assignments)
    same = of_one_pose(first, every)
    shares = np.exp(logarithms)
    shares = shares / shares.sum()
    pose = float(shares[same].sum())
    others, rest = every[~same], shares[~same]
    each = pose * local + rest @ (others == first)
    unmatched = pose * none + rest @ (others < 0)
    return Marginals(np.asarray(each), np.asarray(unmatched), pose)

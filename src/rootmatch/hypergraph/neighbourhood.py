"""The one-change neighbourhood of an assignment, shared by the posterior and the search."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]


class Changes(NamedTuple):
    """K changes of one assignment: a source point gets another target, and maybe a second point another one."""

    source: Integers
    """(K,) source point."""
    target: Integers
    """(K,) its new target, −1 where it becomes unmatched."""
    other: Integers
    """(K,) second source point, −1 for none."""
    other_target: Integers
    """(K,) the new target of the second point, −1 for none."""

    def take(self, which: NDArray[np.integer] | NDArray[np.bool_]) -> Changes:
        """A subset of the changes."""
        return Changes(*(column[which] for column in self))

    def applied_to(self, assignment: Integers) -> Integers:
        """The changed assignments, (K, n)."""
        changed = np.repeat(assignment[None], len(self.source), axis=0)
        rows, second = np.arange(len(changed)), self.other >= 0
        changed[rows, self.source] = self.target
        changed[rows[second], self.other[second]] = self.other_target[second]
        return changed


def one_change_neighbours(assignment: Integers, n_target: int, *, resize: bool = False) -> Changes:
    """The assignments that differ by one change: a moved point, or two points with exchanged targets.

    Listed in this order: a matched point moved to a free target; a matched point exchanged with another one, or its
    target handed to an unmatched point.

    Parameters
    ----------
    assignment : (n,) int64 array
        −1 where unmatched.
    n_target : int
    resize : bool
        Also changes of how many points are matched: an unmatched point to a free target, and, after all moves, a
        matched point that becomes unmatched.
    """
    matched = assignment >= 0
    free = np.ones(n_target, np.bool_)
    free[assignment[matched]] = False
    source, target = np.nonzero((matched | resize)[:, None] & free)
    dropped = np.flatnonzero(matched & resize)
    every = np.arange(len(assignment))
    first, second = np.nonzero(matched[:, None] & (~matched | (every[:, None] < every)))
    none = np.full(len(source) + len(dropped), -1)
    return Changes(
        np.concatenate([source, dropped, first]),
        np.concatenate([target, none[: len(dropped)], assignment[second]]),
        np.concatenate([none, second]),
        np.concatenate([none, assignment[first]]),
    )


def likely_changes(
    assignment: Integers, gains: NDArray[np.float64], least: float
) -> tuple[Changes, NDArray[np.float64]]:
    """The one-change neighbours, resized ones too, whose gain to first order is above ``least``, and those gains.

    As `one_change_neighbours` and a sum over each change's correspondences, without listing all of them.

    Parameters
    ----------
    assignment : (n,) int64 array
    gains : (n, n') array
        What each correspondence adds, given the rest of the assignment; finite where it is in the assignment.
    least : float
    """
    from rootmatch.hypergraph.change_listing import list_changes  # takes Numba

    capacity = 4 * len(assignment) + 16
    while True:
        columns, gain = np.empty((4, capacity), np.int64), np.empty(capacity)
        count = list_changes(assignment, gains, least, columns, gain)
        if count <= capacity:
            return Changes(*columns[:, :count]), gain[:count]
        capacity = count

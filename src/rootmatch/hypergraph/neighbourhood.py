"""The one-change neighbourhood of an assignment, shared by the posterior and the search."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers


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

    def take(self, which: NDArray[np.integer] | Bools) -> Changes:
        """A subset of the changes."""
        return Changes(*(column[which] for column in self))

    def apply_to(self, assignment: Integers) -> Integers:
        """The changed assignments, (K, n)."""
        changed = np.repeat(assignment[None], len(self.source), axis=0)
        rows, second = np.arange(len(changed)), self.other >= 0
        changed[rows, self.source] = self.target
        changed[rows[second], self.other[second]] = self.other_target[second]
        return changed


def likely_changes(assignment: Integers, gains: Floats, least: float) -> tuple[Changes, Floats]:
    """The one-change neighbours whose gain to first order is above ``least``, and those gains.

    An assignment is a neighbour if a point is moved to a free target, becomes unmatched or hands its target to an
    unmatched point, or if two points exchange their targets; neighbours are listed in this order.

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

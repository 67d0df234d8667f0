"""The assignment of a clear soft one, whose largest entries of all lines do not collide: there is nothing to solve."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import driver

INVALID, UNCLEAR, CLEAR = 0, 1, 2
"""What `assign_clear` says of a soft assignment."""


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

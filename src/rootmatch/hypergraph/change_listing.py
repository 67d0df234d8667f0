"""Changes of one assignment that are not out of the question, listed by one pass over their gains, compiled."""

from __future__ import annotations

import numpy as np

from rootmatch.jit.decorators import driver, part


@part
def _enter_change(columns, gain, count, change, value):  # type: ignore[no-untyped-def]
    """Enter a change if there is room; returns the number of changes with it."""
    if count < gain.size:
        for column in range(4):
            columns[column, count] = change[column]
        gain[count] = value
    return count + 1


@part
def enumerate_changes(assignment, gains, minimum, columns, gain):  # type: ignore[no-untyped-def]
    """As `list_changes`."""
    n, n_target = gains.shape
    free = np.ones(n_target, np.bool_)
    own = np.zeros(n)
    for i in range(n):
        if assignment[i] >= 0:
            free[assignment[i]] = False
            own[i] = gains[i, assignment[i]]
    count = 0
    for i in range(n):
        for j in range(n_target):
            if free[j] and gains[i, j] - own[i] > minimum:
                count = _enter_change(columns, gain, count, (i, j, -1, -1), gains[i, j] - own[i])
    for i in range(n):
        if assignment[i] >= 0 and -own[i] > minimum:
            count = _enter_change(columns, gain, count, (i, -1, -1, -1), -own[i])
    for other in range(n):
        if assignment[other] >= 0:
            continue
        for i in range(n):
            j = assignment[i]
            if j >= 0 and gains[other, j] - own[i] > minimum:
                count = _enter_change(columns, gain, count, (i, -1, other, j), gains[other, j] - own[i])
    for i in range(n):
        for other in range(i):
            j, k = assignment[i], assignment[other]
            if j >= 0 and k >= 0:
                value = (gains[i, k] - own[i]) + (gains[other, j] - own[other])
                if value > minimum:
                    count = _enter_change(columns, gain, count, (i, k, other, j), value)
    return count


@driver(nogil=True)
def list_changes(assignment, gains, minimum, columns, gain):  # type: ignore[no-untyped-def]
    """Fill in the changes (4, C) whose gain is above ``minimum``, and those gains (C,), as far as there is room.

    Returns how many there are, in the order of `rootmatch.model.weighed_labellings.likely_changes`.
    """
    return enumerate_changes(assignment, gains, minimum, columns, gain)

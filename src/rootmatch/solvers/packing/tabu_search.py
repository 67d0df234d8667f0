"""Weighted set packing by tabu search: the most valuable disjoint sets, at most so many of them."""

from __future__ import annotations

import numpy as np

from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function

MIN_TENURE, STRIDE, SPREAD = 3, 7, 11
"""Steps for which a set that left may not enter again: 3 to 13, spread evenly without a random number. Not tuned."""
ROUNDING = 1e-9
"""Improvement that is rounding."""


@driver()
def search_packing(elements, values, count, maximum, start, patience):  # type: ignore[no-untyped-def]
    """Disjoint sets of a large total value (tabu search; Glover 1989).

    At each step the set enters which gains most after those it conflicts with, and the least valuable where there are
    too many, have left; what left may not enter again for a few steps. Ends when `patience` steps have brought nothing
    better.

    Parameters
    ----------
    elements : (G, k) int64 array
        Elements of each set, −1 for none.
    values : (G,) array
        Positive.
    count : int
        Number of elements.
    maximum : int
        Most sets.
    start : (G,) bool array
        Disjoint sets to start from.
    patience : int

    Returns
    -------
    best : (G,) bool array
    """
    sets, width = elements.shape
    owner = np.full(count, -1, np.int64)
    inside = np.zeros(sets, np.bool_)
    banned = np.zeros(sets, np.int64)
    pushed = np.full(width + 1, -1, np.int64)
    value, held, step, improved = 0.0, 0, 0, 0
    for g in range(sets):
        if start[g]:
            inside[g] = True
            held += 1
            value += values[g]
            for p in range(width):
                if elements[g, p] >= 0:
                    owner[elements[g, p]] = g
    best, best_value = inside.copy(), value
    while sets > 0 and step - improved < patience:
        step += 1
        minimum = -1
        if held >= maximum:
            for g in range(sets):
                if inside[g] and (minimum < 0 or values[g] < values[minimum]):
                    minimum = g
        gain, entering = -np.inf, -1
        for g in range(sets):
            if inside[g] or values[g] <= gain:
                continue
            out = 0
            change = values[g]
            for p in range(width):
                if elements[g, p] < 0:
                    break
                holder = owner[elements[g, p]]
                if holder >= 0:
                    known = False
                    for q in range(out):
                        known = known or pushed[q] == holder
                    if not known:
                        pushed[out] = holder
                        out += 1
                        change -= values[holder]
            if out == 0 and minimum >= 0:
                change -= values[minimum]
            # a set that may not enter does so all the same where that is the best ever
            if change > gain and (banned[g] < step or value + change > best_value + ROUNDING):
                gain, entering = change, g
        if entering < 0:
            continue
        out = 0
        for p in range(width):
            if elements[entering, p] < 0:
                break
            holder = owner[elements[entering, p]]
            if holder >= 0:
                out += 1
                held -= 1
                _leave(elements, owner, inside, holder)
                banned[holder] = step + MIN_TENURE + STRIDE * step % SPREAD
        if out == 0 and minimum >= 0:
            held -= 1
            _leave(elements, owner, inside, minimum)
            banned[minimum] = step + MIN_TENURE + STRIDE * step % SPREAD
        for p in range(width):
            if elements[entering, p] < 0:
                break
            owner[elements[entering, p]] = entering
        inside[entering] = True
        held += 1
        value += gain
        if value > best_value + ROUNDING:
            best_value, improved = value, step
            # `best[:] = inside` would be compiled with all the text of an error: four seconds
            for g in range(sets):
                best[g] = inside[g]
    return best


@internal_function()
def _leave(elements, owner, inside, g):  # type: ignore[no-untyped-def]
    inside[g] = False
    for p in range(elements.shape[1]):
        if elements[g, p] < 0:
            break
        owner[elements[g, p]] = -1

"""The best one-to-one assignment of points to detections, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part


@part
def fill_assignment(candidates, gains, assignment):  # type: ignore[no-untyped-def]
    """See `assign_likeliest`: by shortest augmenting paths (Jonker and Volgenant 1987), a point at a time."""
    count, points, some = gains.shape[1], np.empty(gains.shape[0], np.int64), 0
    for i in range(gains.shape[0]):
        assignment[i] = -1
        possible = False
        for j in range(count):
            possible = possible or (candidates[i, j] and gains[i, j] > 0.0)
        if possible:
            points[some] = i
            some += 1
    # places are the detections, and one of each point for none; a path begins at one more
    size = count + some
    owner, before, done = np.full(size + 1, -1, np.int64), np.empty(size + 1, np.int64), np.empty(size + 1, np.bool_)
    of_point, of_place, length = np.zeros(some), np.zeros(size + 1), np.empty(size + 1)
    for first in range(some):
        owner[size], place = first, size
        length[:], done[:] = math.inf, False
        while owner[place] >= 0:
            point, done[place] = owner[place], True
            i, step, nearest = points[point], math.inf, size
            for j in range(size):
                if done[j]:
                    continue
                if (j < count and candidates[i, j] and gains[i, j] > 0.0) or j - count == point:
                    more = (-gains[i, j] if j < count else 0.0) - of_point[point] - of_place[j]
                    if more < length[j]:
                        length[j], before[j] = more, place
                if length[j] < step:
                    step, nearest = length[j], j
            for j in range(size + 1):
                if done[j]:
                    of_point[owner[j]] += step
                    of_place[j] -= step
                else:
                    length[j] -= step
            place = nearest
        while place != size:
            owner[place] = owner[before[place]]
            place = before[place]
    for j in range(count):
        if owner[j] >= 0:
            assignment[points[owner[j]]] = j


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def assign_likeliest(candidates, gains, assignment):  # type: ignore[no-untyped-def]
    """Fill in the assignment (n,), −1 for none, with the largest sum of ``gains`` (n, n') over ``candidates`` (n, n').

    Pairs are independent, but for being one to one.
    """
    candidates, gains, assignment = borrow((candidates, gains, assignment))
    fill_assignment(candidates, gains, assignment)

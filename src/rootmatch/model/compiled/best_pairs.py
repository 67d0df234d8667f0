"""The most probable one-to-one pairs of points and detections, compiled: an assignment problem of a few dozen rows."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import part


@part
def pair_best(candidates, gains, assignment):  # type: ignore[no-untyped-def]
    """Fill an assignment (n,) with the pairs of candidates (n, n') whose positive gains (n, n') sum to the most.

    −1 for a point without one. By shortest augmenting paths (Jonker and Volgenant 1987): each point in turn takes a
    detection, or none, and those that held what it takes are moved on.
    """
    n, n_target = candidates.shape
    columns = n_target + n + 1  # the last ones are no detection; before all of them, where a path begins
    of_row, of_column = np.zeros(n), np.zeros(columns)
    owner, way = np.full(columns, -1, np.int64), np.empty(columns, np.int64)
    least, met = np.empty(columns), np.empty(columns, np.bool_)
    for i in range(n):
        some = False
        for j in range(n_target):
            some = some or (candidates[i, j] and gains[i, j] > 0.0)
        assignment[i] = -1
        if not some:
            continue
        owner[0], column = i, 0
        for j in range(columns):
            least[j], met[j] = math.inf, False
        while owner[column] >= 0:
            met[column] = True
            row, nearest, delta = owner[column], 0, math.inf
            for j in range(1, columns):
                if met[j]:
                    continue
                cost = 0.0
                if j <= n_target and candidates[row, j - 1]:
                    cost = -max(gains[row, j - 1], 0.0)
                cost -= of_row[row] + of_column[j]
                if cost < least[j]:
                    least[j], way[j] = cost, column
                if least[j] < delta:
                    nearest, delta = j, least[j]
            for j in range(columns):
                if met[j]:
                    of_row[owner[j]] += delta
                    of_column[j] -= delta
                else:
                    least[j] -= delta
            column = nearest
        while column > 0:
            owner[column] = owner[way[column]]
            column = way[column]
    for j in range(1, n_target + 1):
        i = owner[j]
        if i >= 0 and candidates[i, j - 1] and gains[i, j - 1] > 0.0:
            assignment[i] = j - 1

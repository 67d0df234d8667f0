"""The changes of a mode's assignment that may count, and the sums over them, compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.hypergraph.change_listing import enumerate_changes
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.single_changes import fill_match_gains

IMPOSSIBLE = -1e9
"""Log-odds used in place of −∞, so that differences stay finite."""


@part
def _is_free(changed, change):  # type: ignore[no-untyped-def]
    """Whether a change leaves no detection with a second owner, given the assignment so far."""
    source, target, other, other_target = change
    for point in range(changed.shape[0]):
        if point in (source, other) or changed[point] < 0:
            continue
        if changed[point] in (target, other_target):
            return False
    return True


@part
def _apply_compatible(columns, order, positive, changed):  # type: ignore[no-untyped-def]
    """Make the first changes of an order, as long as they gain, where two are not of one point or detection.

    ``changed`` (n,): the assignment, which they change. How many there are.
    """
    moved, count = np.zeros(changed.shape[0], np.bool_), 0
    for place in range(positive):
        k = order[place]
        source, target, other, other_target = columns[0, k], columns[1, k], columns[2, k], columns[3, k]
        if moved[source] or (other >= 0 and moved[other]):
            continue
        if not _is_free(changed, (source, target, other, other_target)):
            continue
        changed[source], moved[source] = target, True
        if other >= 0:
            changed[other], moved[other] = other_target, True
        count += 1
    return count


def likely_mode_changes(
    assignment: Integers, points: tuple[Any, ...], covariance: Floats, image: tuple[Any, ...], limits: tuple[Any, ...]
) -> tuple[Integers, Floats, Integers, Integers]:
    """The changes of a mode that are not negligible to first order in its pose, and the best ones made.

    Parameters
    ----------
    assignment, points, covariance
        As `fill_match_gains` takes them.
    image : tuple
        As for `rootmatch.model.compiled.gating.gate`, and what
        `rootmatch.model.detection_model.DetectionModel.log_counts` adds up: logarithms (C, n' + 1) of the odds of
        counts, and the image (n',) of each detection.
    limits : tuple
        The detection rate, NaN for the one that the assignment suggests; the least gain, whether the assignment may
        lose a match, how many changes are made, and the fewest matches of all changes together.

    Returns
    -------
    columns, gains : (4, R) int64 and (C,) float64 arrays
        The changes as in `rootmatch.model.weighed_labellings.Changes`, in the first C columns, and what they gain.
    order : (S,) int64 array
        Those of the largest gains.
    changed : (S, n) or (S + 1, n) int64 array
        The assignment after each of these, and after all of them that gain together, if that is more than one.
    """
    n, maximum = len(assignment), limits[3]
    room = 4 * n + 16
    while True:  # room made here: an array that a kernel returns takes longer than one it is given
        columns, gains = np.empty((4, room), np.int64), np.empty(room)
        order, changed = np.empty(maximum, np.int64), np.empty((maximum + 1, n), np.int64)
        out = columns, gains, order, changed
        count, size, rows = list_changes(assignment, points, covariance, image, limits, out)
        if count <= room:
            return columns, gains[:count], order[:size], changed[:rows]
        room = count


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def list_changes(assignment, points, covariance, image, limits, out):  # type: ignore[no-untyped-def]
    """Fill what `likely_mode_changes` tells, as far as there is room; how many changes, those made, and rows are."""
    assignment, points, covariance, image, out = borrow((assignment, points, covariance, image, out))
    kept, gain, order, changed = out
    target, sigma, blur, log_clutter, log_weights, log_counts, image_of = image
    rate, min_gain, may_lose, maximum, minimum = limits
    n = assignment.shape[0]
    matches, total, visible = np.zeros(log_counts.shape[0], np.int64), 0, 0.0
    for i in range(n):
        visible += points[3][i]
        if assignment[i] >= 0:
            matches[image_of[assignment[i]]] += 1
            total += 1
    if not rate >= 0.0:
        rate = (total + 0.5) / (max(visible, total) + 1.0)
    log_count = np.empty(target.shape[0])  # what one match more changes, as the last one of its image
    for j in range(target.shape[0]):
        count = max(matches[image_of[j]], 1)
        log_count[j] = log_counts[image_of[j], count] - log_counts[image_of[j], count - 1]
    every = np.empty((n, target.shape[0]))
    detections = target, sigma, blur, log_clutter, log_weights, log_count
    fill_match_gains(assignment, points, covariance, detections, rate, every)
    for i in range(n):
        if assignment[i] >= 0 and not abs(every[i, assignment[i]]) < math.inf:
            every[i, assignment[i]] = IMPOSSIBLE
    room = 4 * n + 16
    columns, gains = np.empty((4, room), np.int64), np.empty(room)
    listed = enumerate_changes(assignment, every, min_gain, columns, gains)
    if listed > room:
        columns, gains = np.empty((4, listed), np.int64), np.empty(listed)
        enumerate_changes(assignment, every, min_gain, columns, gains)
    count = 0
    for k in range(listed):
        count += 1 if may_lose or columns[1, k] >= 0 or columns[2, k] >= 0 else 0
    size, place = min(maximum, count), 0
    if count > gain.shape[0]:
        return count, size, 0
    # element by element here and below: the checks of whole rows take longer to compile than all the rest
    for k in range(listed):
        if may_lose or columns[1, k] >= 0 or columns[2, k] >= 0:
            for row in range(4):
                kept[row, place] = columns[row, k]
            gain[place] = gains[k]
            place += 1
    chosen, positive = np.zeros(count, np.bool_), 0
    for place in range(size):
        best = -1
        for k in range(count):
            if not chosen[k] and (best < 0 or gain[k] > gain[best]):
                best = k
        order[place], chosen[best] = best, True
        positive += 1 if gain[best] > 0.0 else 0
    together, left = assignment.copy(), 0
    several = _apply_compatible(kept, order, positive, together)
    for i in range(n):
        left += 1 if together[i] >= 0 else 0
    rows = size + 1 if several > 1 and left >= minimum else size
    for row in range(rows):
        for i in range(n):
            changed[row, i] = assignment[i] if row < size else together[i]
        if row < size:
            k = order[row]
            changed[row, kept[0, k]] = kept[1, k]
            if kept[2, k] >= 0:
                changed[row, kept[2, k]] = kept[3, k]
    return count, size, rows


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def sum_over_changes(assignment, columns, gains, independent, local, unmatched):  # type: ignore[no-untyped-def]
    """Logarithm of the sum over the changes of a mode, over its own evidence, and what it makes of each point.

    Parameters
    ----------
    assignment : (n,) int64 array
    columns, gains : (4, R) and (C,) arrays
        Of `likely_mode_changes`, R no less than C.
    independent : int
        Matches from which changes of different points are independent.
    local, unmatched : (n,) arrays
        As `rootmatch.model.modes.Modes`; filled.
    """
    assignment, columns, gains, local, unmatched = borrow((assignment, columns, gains, local, unmatched))
    n = assignment.shape[0]
    own, left_out, matched = np.zeros(n), np.zeros(n), 0
    for i in range(n):
        local[i] = 0.0
    for k in range(gains.shape[0]):
        weight = math.exp(min(gains[k], 0.0))
        own[columns[0, k]] += weight
        if columns[1, k] < 0:  # whether or not another point has its detection then
            left_out[columns[0, k]] += weight
        if columns[2, k] >= 0:
            local[columns[2, k]] += weight
    product, every = 0.0, 1.0
    for i in range(n):
        matched += 1 if assignment[i] >= 0 else 0
        local[i] += own[i]
        product += math.log1p(own[i])
        every += own[i]
    for i in range(n):
        if matched >= independent:
            local[i] = share = 1.0 / (1.0 + local[i])
        else:
            local[i], share = 1.0 - local[i] / every, 1.0 / every
        unmatched[i] = left_out[i] * share if assignment[i] >= 0 else local[i]
    return product if matched >= independent else math.log(every)

"""What is hidden as a whole, compiled: the part of an image beyond a straight edge, all but a window, what is small.

Points are not missed one by one only. A hand, a frame or fog hides a part of an image, a detector or an unknown image
size shows no more than a window of it. How many points lie beyond then says nothing of the detection rate, nor of the
pose. And every detector has a limit of distance: what is too far away appears too small or too faint.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import part
from rootmatch.model.compiled.rates import fill_miss_products
from rootmatch.model.priors import DEPTHS
from rootmatch.model.visibility import BARELY, FULLY

OCCLUDED = 0.1
"""Probability that a part of a body is hidden as a whole in an image. A stated value, not measured."""
DIRECTIONS = 8
"""Directions in which an edge may face, all equally probable: nearer ones hide much the same. A window has an edge in
each."""
EDGE, WINDOW = 0, 1
"""What hides a part of an image, equally probable."""
OCTAVES = math.log(DEPTHS)
"""Logarithm of the range of distances: of bodies, and of the limit up to which a detector sees them. Both are anywhere
in it, each octave as probable, as long as the nearest point is within the limit."""
FARTHEST = 1.0 / DEPTHS
"""Part of the range that is left beyond its end: what lies there is seen as well, though hardly ever. A round value."""
MIN_HIDDEN = 2.0
"""Missing visible points beyond which an edge or a window is looked for: fewer are as well missed one by one. A round
value."""
MAX_MISSED = 6.0
"""Points missed one by one before a limit: more are never worth it. A round value."""
ABOVE_ROUNDING = 1.0 + 1e-9
"""Factor by which a window has to hide more than an edge: sums of the same points may differ by rounding."""
LOG_ODDS = math.log(0.5 * OCCLUDED) - math.log1p(-OCCLUDED)
"""Of one of them against neither."""
LOG_FREE = math.log1p(-OCCLUDED)


TURNS = tuple(2.0 * math.pi * turn / DIRECTIONS for turn in range(DIRECTIONS))
ACROSS, DOWN = np.array([math.cos(turn) for turn in TURNS]), np.array([math.sin(turn) for turn in TURNS])


@part
def _squared_size(jacobian):  # type: ignore[no-untyped-def]
    """Square of the angle that a length at a point appears in, by its Jacobian (2, 6), in units of the focal length.

    A pinhole stretches what is θ aside by 1 / cos θ across and 1 / cos² θ along, so that is left out.
    """
    across, along, both = 0.0, 0.0, 0.0
    for a in range(3, 6):
        across += jacobian[0, a] * jacobian[0, a]
        along += jacobian[1, a] * jacobian[1, a]
        both += jacobian[0, a] * jacobian[1, a]
    more = math.sqrt(0.25 * (across - along) ** 2 + both * both)
    largest = 0.5 * (across + along) + more
    return (largest - 2.0 * more) ** 2 / largest if largest > 0.0 else 0.0


@part
def fill_sizes(assignment, jacobian, sizes):  # type: ignore[no-untyped-def]
    """Squares of the sizes at which points appear, into ``sizes`` (n,); that of the farthest match, or ∞."""
    farthest = math.inf
    for i in range(assignment.shape[0]):
        sizes[i] = _squared_size(jacobian[i])
        if assignment[i] >= 0:
            farthest = min(farthest, sizes[i])
    return farthest


@part
def largest_size(assignment, shown, sizes):  # type: ignore[no-untyped-def]
    """The largest of the ``sizes`` (n,) of points in view, 0 if there is none."""
    nearest = 0.0
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0 or shown[i] > FULLY:
            nearest = max(nearest, sizes[i])
    return nearest


@part
def order_smaller(size, sizes, order):  # type: ignore[no-untyped-def]
    """Numbers of the points that appear smaller than a size, the largest first, into ``order`` (n,); how many."""
    count = 0
    for i in range(sizes.shape[0]):
        if sizes[i] < size:
            order[count] = i
            count += 1
    gap = 1
    while 9 * gap < count:  # Shell's steps; of equal ones the first comes first
        gap = 3 * gap + 1
    while gap > 0:
        for t in range(gap, count):
            point, s = order[t], t
            while s >= gap:
                before = order[s - gap]
                if sizes[before] > sizes[point] or (sizes[before] == sizes[point] and before < point):
                    break
                order[s] = before
                s -= gap
            order[s] = point
        gap //= 3
    return count


@part
def _chance_within_range(nearest, size):  # type: ignore[no-untyped-def]
    """Probability S that the limit of distance lies beyond what appears at a size, given what the nearest point has.

    The logarithms of the nearest distance and of the limit are uniform in `OCTAVES`, the former below the latter, so
    their difference has the density 2 (D − x) / D².
    """
    left = 1.0 - 0.5 * math.log(max(nearest / size, 1.0)) / OCTAVES
    return max(left, FARTHEST) ** 2


@part
def log_with_range_limit(missing, far, matches, sizes, order, nearest, smallest, rates, log_weights, steps, products):  # type: ignore[no-untyped-def]
    """What `log_over_rates` is with a limit of distance, integrated over where that lies; ``owned`` apart.

    Between two successive points it hides the farther one and all beyond, with the probability S there less S here, see
    `_reached`; no match is hidden. ``far``: `log_over_rates` if none is. ``sizes``: as of `fill_sizes`; ``nearest`` and
    ``smallest``: those of the nearest point in view and of the farthest match; ``order``: of `order_smaller` that.
    ``steps`` (2, n) and ``products`` (2, Q): scratch.
    """
    end = order.shape[0]
    while end > 0 and missing[order[end - 1]] <= BARELY:
        end -= 1
    last = sizes[order[end - 1]] if end > 0 else smallest
    out = far + math.log(_chance_within_range(nearest, last))
    if end == 0:
        return out
    count, missed, at, here = 0, 0.0, 0, _chance_within_range(nearest, smallest)
    while missed < MAX_MISSED and at < end:
        while missing[order[at]] <= BARELY:
            at += 1
        lower = sizes[order[at]]
        there = _chance_within_range(nearest, lower)
        weight = here - there
        while at < end and sizes[order[at]] == lower:
            point = order[at]
            if missing[point] > BARELY:
                steps[0, count], steps[1, count] = weight, missing[point]
                count, weight, missed = count + 1, 0.0, missed + missing[point]
            at += 1
        here = there
    fill_miss_products(missing, sizes, smallest, rates, products)
    for q in range(rates.shape[0]):
        rate, product, total = rates[q], 1.0, 0.0
        for step in range(count):
            total += steps[0, step] * product
            product *= 1.0 - rate * steps[1, step]
        if total == 0.0:
            continue
        each = log_weights[q] + matches * math.log(rate) + math.log(total) + products[1, q] + math.log(products[0, q])
        out = max(out, each) + math.log1p(math.exp(-abs(out - each)))
    return out


@part
def find_occluders(assignment, pixels, missing, images, reaches, in_sight, odds):  # type: ignore[no-untyped-def]
    """The edges and the windows, one in each image, that leave all matches in sight and hide most of what is missing.

    ``assignment`` (n,), ``pixels`` (n, 2) and ``missing`` (n,), the visibility of the points without a detection, of so
    many ``images``, one after the other. ``reaches`` (8,): scratch.

    ``odds`` (2,): logarithm of the odds of all edges and of all windows, −∞ if none is worth it; ``in_sight`` (2, n): 0
    for the points that they hide, else 1.
    """
    each = pixels.shape[0] // images
    odds[EDGE] = odds[WINDOW] = -math.inf
    in_sight[:] = 1.0
    for image in range(images):
        first, end = image * each, (image + 1) * each
        maximum, way, outside, points = MIN_HIDDEN, -1, 0.0, 0.0
        for turn in range(DIRECTIONS):
            across, down, reach, beyond = ACROSS[turn], DOWN[turn], -math.inf, 0.0
            for i in range(first, end):
                if assignment[i] >= 0:
                    reach = max(reach, across * pixels[i, 0] + down * pixels[i, 1])
            reaches[turn] = reach
            for i in range(first, end):
                if missing[i] > 0.0 and across * pixels[i, 0] + down * pixels[i, 1] > reach:
                    beyond += missing[i]
            if beyond > maximum:
                maximum, way = beyond, turn
        if way < 0:
            continue
        for i in range(first, end):
            points += missing[i] if assignment[i] < 0 else 1.0
            if missing[i] > 0.0:
                if ACROSS[way] * pixels[i, 0] + DOWN[way] * pixels[i, 1] > reaches[way]:
                    in_sight[EDGE, i] = 0.0
                for turn in range(DIRECTIONS):
                    if ACROSS[turn] * pixels[i, 0] + DOWN[turn] * pixels[i, 1] > reaches[turn]:
                        in_sight[WINDOW, i] = 0.0
                        outside += missing[i]
                        break
        # a line in one of the directions parts the points in one way for each, a circle in one for each three of them
        before = odds[EDGE] if odds[EDGE] > -math.inf else 0.0
        odds[EDGE] = before + LOG_ODDS - math.log(DIRECTIONS * points)
        if outside > maximum * ABOVE_ROUNDING:
            before = odds[WINDOW] if odds[WINDOW] > -math.inf else 0.0
            odds[WINDOW] = before + LOG_ODDS - math.log(points * points * points / 6.0)
        else:  # what one edge hides already
            for i in range(first, end):
                in_sight[WINDOW, i] = 1.0

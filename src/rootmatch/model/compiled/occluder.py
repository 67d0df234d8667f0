"""What is hidden as a whole, compiled: the part of an image beyond a straight edge, all but a window, what is small.

Points are not missed one by one only. A hand, a frame or fog hides a part of an image, a detector or an unknown image
size shows no more than a window of it, and what is too far away appears too small or too faint. How many points lie
beyond then says nothing of the detection rate, nor of the pose.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import part

OCCLUDED = 0.1
"""Probability that a part of a body is hidden as a whole in an image. A stated value, not measured."""
DIRECTIONS = 8
"""Directions in which an edge may face, all equally probable: nearer ones hide much the same. A window has an edge in
each."""
EDGE, WINDOW, DISTANCE = 0, 1, 2
"""What hides: the first two are equally probable."""
SIZES = math.log(16.0)
"""Logarithm of the range of apparent sizes in which the least that a detector sees may lie, all equally probable: what
is seen at a sixteenth of the size has a 256th of the light, the least in an image of 8 bits. Of points that are about
equally far away it hides all or none; of a street, it is within it as probably as not. A stated value, not
measured."""
LEAST_HIDDEN = 2.0
"""Missing visible points beyond which it is looked for: fewer are as well missed one by one. A round value."""
LOG_MISSED = math.log(0.2)
"""Of a point that is missed by itself, in the choice of the limit only. A round value."""
MOST_MISSED = 6.0
"""Such points before a limit: more are never worth it. A round value."""
LOG_ODDS = math.log(0.5 * OCCLUDED) - math.log1p(-OCCLUDED)
"""Of one of the first two against neither."""
LOG_FREE = math.log1p(-OCCLUDED)


TURNS = tuple(2.0 * math.pi * turn / DIRECTIONS for turn in range(DIRECTIONS))
ACROSS, DOWN = np.array([math.cos(turn) for turn in TURNS]), np.array([math.sin(turn) for turn in TURNS])


@part
def _size(jacobian):  # type: ignore[no-untyped-def]
    """Square of the size at which the surroundings of a point appear, by its Jacobian (2, 6)."""
    size = 0.0
    for q in range(2):
        for a in range(3, 6):
            size += jacobian[q, a] * jacobian[q, a]
    return size


@part
def _beyond(assignment, jacobian, missing, in_sight):  # type: ignore[no-untyped-def]
    """Logarithm of the odds that what appears small enough is too small, as `hide` has it for one kind.

    The limit lies between the sizes of two missing points, or of the smallest match and one. What is larger than the
    limit was missed one by one: next to the smallest match is often a point of the same distance.
    """
    upper, beyond = math.inf, 0.0
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0:
            upper = min(upper, _size(jacobian[i]))
    for i in range(assignment.shape[0]):
        if missing[i] > 0.0 and _size(jacobian[i]) < upper:
            beyond += missing[i]
    if upper == math.inf:  # without a match, any limit is as probable
        return -math.inf
    best, width, limit, missed = 0.0, 0.0, 0.0, 0.0
    while beyond > LEAST_HIDDEN and missed < MOST_MISSED:
        lower, hidden = 0.0, 0.0
        for i in range(assignment.shape[0]):
            if missing[i] > 0.0:
                size = _size(jacobian[i])
                if size < upper:
                    if size > lower:
                        lower, hidden = size, 0.0
                    if size == lower:
                        hidden += missing[i]
        if math.log(upper / lower) * math.exp(missed * LOG_MISSED) > best:
            width, limit = math.log(upper / lower), upper
            best = width * math.exp(missed * LOG_MISSED)
        upper, beyond, missed = lower, beyond - hidden, missed + hidden
    if width == 0.0:
        return -math.inf
    for i in range(assignment.shape[0]):
        if missing[i] > 0.0 and _size(jacobian[i]) < limit:
            in_sight[i] = 0.0
    return math.log(0.5 * width / SIZES)


@part
def hide(assignment, pixels, jacobian, missing, images, reaches, in_sight, odds):  # type: ignore[no-untyped-def]
    """The edges and the windows, one in each image, that leave all matches in sight and hide most of what is missing.

    And the distance beyond which all is missing. ``assignment`` (n,), ``pixels`` (n, 2), ``jacobian`` (n, 2, 6) and
    ``missing`` (n,), the visibility of the points without a detection, of so many ``images``, one after the other.
    ``reaches`` (8,): scratch.

    ``odds`` (3,): logarithm of the odds of all edges, of all windows and of a distance, −∞ if none is worth it;
    ``in_sight`` (3, n): 0 for the points that they hide, else 1.
    """
    each = pixels.shape[0] // images
    odds[EDGE] = odds[WINDOW] = -math.inf
    in_sight[:] = 1.0
    odds[DISTANCE] = _beyond(assignment, jacobian, missing, in_sight[DISTANCE])
    for image in range(images):
        first, end = image * each, (image + 1) * each
        most, way, outside, points = LEAST_HIDDEN, -1, 0.0, 0.0
        for turn in range(DIRECTIONS):
            across, down, reach, beyond = ACROSS[turn], DOWN[turn], -math.inf, 0.0
            for i in range(first, end):
                if assignment[i] >= 0:
                    reach = max(reach, across * pixels[i, 0] + down * pixels[i, 1])
            reaches[turn] = reach
            for i in range(first, end):
                if missing[i] > 0.0 and across * pixels[i, 0] + down * pixels[i, 1] > reach:
                    beyond += missing[i]
            if beyond > most:
                most, way = beyond, turn
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
        if outside > most:
            before = odds[WINDOW] if odds[WINDOW] > -math.inf else 0.0
            odds[WINDOW] = before + LOG_ODDS - math.log(points * points * points / 6.0)
        else:  # what one edge hides already
            for i in range(first, end):
                in_sight[WINDOW, i] = 1.0

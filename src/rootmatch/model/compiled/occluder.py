"""What is hidden as a whole, compiled: the part of an image beyond a straight edge, or all but a window.

Points are not missed one by one only. A hand, a frame or fog hides a part of an image, a detector or an unknown image
size shows no more than a window of it. How many points lie beyond then says nothing of the detection rate, nor of the
pose.
"""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part

OCCLUDED = 0.1
"""Probability that a part of a body is hidden as a whole in an image. A stated value, not measured."""
DIRECTIONS = 8
"""Directions in which an edge may face, all equally probable: nearer ones hide much the same. A window has an edge in
each."""
EDGE, WINDOW = 0, 1
"""What hides, equally probable."""
LEAST_HIDDEN = 2.0
"""Missing visible points beyond which it is looked for: fewer are as well missed one by one. A round value."""
LOG_ODDS = math.log(0.5 * OCCLUDED) - math.log1p(-OCCLUDED)
"""Of one of the two against neither."""
LOG_FREE = math.log1p(-OCCLUDED)


@part
def log_of_places(kind, points):  # type: ignore[no-untyped-def]
    """Logarithm of the number of ways in which an edge, or a window, may part so many visible points.

    A line in one of the directions has one for each point, a circle one for each three of them.
    """
    return math.log(DIRECTIONS * points) if kind == EDGE else math.log(points * points * points / 6.0)


@part
def hide(kind, assignment, pixels, missing, image, reaches, in_sight):  # type: ignore[no-untyped-def]
    """The edge or the window in one image that leaves all matches in sight and hides most of what is missing.

    ``assignment`` (n,), ``pixels`` (n, 2) and ``missing`` (n,), the visibility of the points without a detection;
    ``image``: the first row of an image, and that after its last. ``in_sight`` (n,) gets 0 for what is hidden.
    Returns the logarithm of its odds, −∞ if none is worth it. ``reaches`` (8,): scratch.
    """
    first, end = image
    most, way, hidden, points = LEAST_HIDDEN, -1, 0.0, 0.0
    for turn in range(DIRECTIONS):
        angle = 2.0 * math.pi * turn / DIRECTIONS
        across, down, reach, beyond = math.cos(angle), math.sin(angle), -math.inf, 0.0
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
        return -math.inf
    for i in range(first, end):
        points += missing[i] if assignment[i] < 0 else 1.0
        if missing[i] > 0.0:
            for turn in range(DIRECTIONS):
                if kind == WINDOW or turn == way:
                    angle = 2.0 * math.pi * turn / DIRECTIONS
                    if math.cos(angle) * pixels[i, 0] + math.sin(angle) * pixels[i, 1] > reaches[turn]:
                        hidden += missing[i]
                        in_sight[i] = 0.0
                        break
    if kind == WINDOW and hidden <= most:
        return -math.inf  # what one edge hides already
    return LOG_ODDS - log_of_places(kind, points)

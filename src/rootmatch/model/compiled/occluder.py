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
each. Both may have one more, that in which the matches and what is missing are best told apart: see
`_fill_direction_apart`."""
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
STEP = 1.0 / 32.0
"""Step of the integral over the logarithm of the limit: half of the width of one point's end."""
STEP_OF_POWER = math.exp(-16.0 * STEP)
"""Factor on (d / L)^16 in a step. The power says how soft a limit is: by it, the logarithms of the distances at which
points are lost have the standard deviation .11. LEDs of one kind differ by some 20 % in brightness, which goes with the
square of a distance. A stated value, not measured."""
MAX_STEPS = 160
"""Steps that go through the range of distances: more tell nothing."""
EARLIER = math.exp(12.0 * STEP)
"""Factor on the square of the size of the farthest match from where limits count: 5 % of it remain there."""
WITHIN = math.exp(-5.0)
"""(d / L)^16 up to which a point counts as within the limit."""
NEARLY = 0.05
"""Sum of that over the matches up to which the product of their shares is one less the sum."""
MAX_CUT = 1e6
"""Factor by which a limit makes the matches less probable, from which it is left out."""
ABOVE_ROUNDING = 1.0 + 1e-9
"""Factor by which one edge, or a window, has to hide more than another: sums of the same points may differ by
rounding."""
RIDGE = 1e-6
"""Added to the scatter of points about their means, as a share of it: those of one line have none across."""
LOG_ODDS = math.log(0.5 * OCCLUDED) - math.log1p(-OCCLUDED)
"""Of one of them against neither."""
LOG_FREE = math.log1p(-OCCLUDED)


TURNS = tuple(2.0 * math.pi * turn / DIRECTIONS for turn in range(DIRECTIONS))
SIDES = np.array([(math.cos(turn), math.sin(turn)) for turn in TURNS])


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
    """Squares of the sizes at which points appear, into ``sizes`` (n,); that of the farthest match.

    Or, if there is none, of the nearest point.
    """
    farthest, nearest = math.inf, 1e-300
    for i in range(assignment.shape[0]):
        sizes[i] = _squared_size(jacobian[i])
        nearest = max(nearest, sizes[i])
        if assignment[i] >= 0:
            farthest = min(farthest, sizes[i])
    return min(farthest, nearest)


@part
def largest_size(assignment, shown, sizes):  # type: ignore[no-untyped-def]
    """The largest of the ``sizes`` (n,) of points in view, 0 if there is none."""
    nearest = 0.0
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0 or shown[i] > FULLY:
            nearest = max(nearest, sizes[i])
    return nearest


@part
def _distance_power(reference, size):  # type: ignore[no-untyped-def]
    """The 16th power of a distance over another, by the squares of the sizes at which something appears there."""
    ratio = reference / size
    ratio *= ratio
    ratio *= ratio
    return ratio * ratio


@part
def fill_distance_powers(reference, sizes, powers):  # type: ignore[no-untyped-def]
    """The 16th powers of distances over that of a reference, into ``powers`` (n,).

    ``reference`` and ``sizes`` (n,): squares as of `fill_sizes`.
    """
    for i in range(sizes.shape[0]):
        powers[i] = _distance_power(reference, max(sizes[i], 1e-12 * reference))


@part
def _chance_beyond(distance):  # type: ignore[no-untyped-def]
    """Probability S that the limit lies beyond a logarithm of a distance over that of the nearest point.

    The logarithms of the nearest distance and of the limit are uniform in `OCTAVES`, the former below the latter, so
    their difference has the density 2 (D − x) / D².
    """
    return max(1.0 - distance / OCTAVES, FARTHEST) ** 2


@part
def log_with_range_limit(assignment, missing, far, nearest, reference, powers, rates, log_weights, seen, products):  # type: ignore[no-untyped-def]
    """What `log_over_rates` is with a limit of distance, integrated over where that lies; ``owned`` apart.

    A limit at L is soft: of a point at d it leaves the share 1 / (1 + (d / L)^16). It is integrated over from where it
    cuts the farthest match to where it leaves all, or hides so little that too many points were missed one by one.
    ``far``: `log_over_rates` without a limit. ``nearest``: the square of the size of the nearest point in view;
    ``reference``: that of the farthest match, of which ``powers`` (n,) are, as of `fill_distance_powers`. ``seen``
    (2, n) and ``products`` (4, Q): scratch.
    """
    if nearest == 0.0:
        return far
    size = min(reference * EARLIER, nearest)
    place = 0.5 * math.log(nearest / size)
    power = math.sqrt(STEP_OF_POWER) / _distance_power(reference, size)  # of the reference, in the middle of a step
    limit, count, matches, crowd, last = WITHIN / power, 0, 0, 0.0, 0.0
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0:
            matches += 1
            crowd += powers[i]
            last = max(last, powers[i])
        elif missing[i] > 0.0 and powers[i] > limit:
            seen[0, count], seen[1, count] = powers[i], missing[i]
            last = max(last, powers[i] if missing[i] > BARELY else 0.0)
            count += 1
    fill_miss_products(missing, powers, limit, rates, products)
    products[2] = 0.0
    here = _chance_beyond(place)
    for _ in range(MAX_STEPS):
        place += STEP
        there = _chance_beyond(place)
        kept = 1.0 + crowd * power
        if kept > 1.0 + NEARLY:
            kept = 1.0
            for i in range(assignment.shape[0]):
                if assignment[i] >= 0:
                    kept *= 1.0 + power * powers[i]
                    if kept > MAX_CUT:
                        break
        missed = 0.0
        if kept <= MAX_CUT:
            for q in range(rates.shape[0]):
                products[3, q] = (here - there) / kept
            for point in range(count):
                shown = seen[1, point] / (1.0 + power * seen[0, point])
                missed += shown
                for q in range(rates.shape[0]):
                    products[3, q] *= 1.0 - rates[q] * shown
            for q in range(rates.shape[0]):
                products[2, q] += products[3, q]
        here = there
        power *= STEP_OF_POWER
        if missed > MAX_MISSED or power * last < WITHIN:
            break
    out = far + math.log(here)
    for q in range(rates.shape[0]):
        if products[2, q] == 0.0:
            continue
        each = log_weights[q] + matches * math.log(rates[q])
        each += math.log(products[2, q]) + products[1, q] + math.log(products[0, q])
        out = max(out, each) + math.log1p(math.exp(-abs(out - each)))
    return out


@part
def _fill_direction_apart(assignment, pixels, missing, points, out):  # type: ignore[no-untyped-def]
    """The direction (2,) of Fisher's discriminant, from the matches to what is missing, into ``out``.

    Of the points with numbers from ``points[0]`` up to ``points[1]``. It turns and stretches with the image, so that
    two poses in which a body shows the same and lacks the same are treated alike.
    """
    weights, means, scatter = (0.0, 0.0), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(points[0], points[1]):
        x, y = pixels[i, 0], pixels[i, 1]
        if assignment[i] >= 0:
            weights = weights[0] + 1.0, weights[1]
            means = means[0] + x, means[1] + y, means[2], means[3]
        elif missing[i] > 0.0:
            weight = missing[i]
            weights = weights[0], weights[1] + weight
            means = means[0], means[1], means[2] + weight * x, means[3] + weight * y
    own, lost = max(weights[0], 1.0), max(weights[1], 1.0)
    x0, y0, x1, y1 = means[0] / own, means[1] / own, means[2] / lost, means[3] / lost
    for i in range(points[0], points[1]):
        if assignment[i] >= 0:
            weight, x, y = 1.0, pixels[i, 0] - x0, pixels[i, 1] - y0
        else:
            weight, x, y = missing[i], pixels[i, 0] - x1, pixels[i, 1] - y1
        if weight > 0.0:
            scatter = scatter[0] + weight * x * x, scatter[1] + weight * x * y, scatter[2] + weight * y * y
    ridge = RIDGE * (scatter[0] + scatter[2])
    xx, xy, yy = scatter[0] + ridge, scatter[1], scatter[2] + ridge
    out[0], out[1] = yy * (x1 - x0) - xy * (y1 - y0), xx * (y1 - y0) - xy * (x1 - x0)


@part
def find_occluders(assignment, pixels, missing, images, sides, in_sight, odds):  # type: ignore[no-untyped-def]
    """The edges and the windows, one in each image, that leave all matches in sight and hide most of what is missing.

    ``assignment`` (n,), ``pixels`` (n, 2) and ``missing`` (n,), the visibility of the points without a detection, of so
    many ``images``, one after the other. ``sides`` (9, 3): scratch, of
    directions and how far the matches reach.

    ``odds`` (2,): logarithm of the odds of all edges and of all windows, −∞ if none is worth it; ``in_sight`` (2, n): 0
    for the points that they hide, else 1.
    """
    each = pixels.shape[0] // images
    odds[EDGE] = odds[WINDOW] = -math.inf
    in_sight[:] = 1.0
    for turn in range(DIRECTIONS):
        sides[turn, 0], sides[turn, 1] = SIDES[turn, 0], SIDES[turn, 1]
    for image in range(images):
        first, end = image * each, (image + 1) * each
        _fill_direction_apart(assignment, pixels, missing, (first, end), sides[DIRECTIONS])
        maximum, way, outside, points = MIN_HIDDEN, -1, 0.0, 0.0
        for turn in range(DIRECTIONS + 1):
            across, down, reach, beyond = sides[turn, 0], sides[turn, 1], -math.inf, 0.0
            for i in range(first, end):
                if assignment[i] >= 0:
                    reach = max(reach, across * pixels[i, 0] + down * pixels[i, 1])
            sides[turn, 2] = reach
            for i in range(first, end):
                if missing[i] > 0.0 and across * pixels[i, 0] + down * pixels[i, 1] > reach:
                    beyond += missing[i]
            if beyond > maximum * ABOVE_ROUNDING:
                maximum, way = beyond, turn
        if way < 0:
            continue
        for i in range(first, end):
            points += missing[i] if assignment[i] < 0 else 1.0
            if missing[i] > 0.0:
                if sides[way, 0] * pixels[i, 0] + sides[way, 1] * pixels[i, 1] > sides[way, 2]:
                    in_sight[EDGE, i] = 0.0
                for turn in range(DIRECTIONS + 1):
                    if sides[turn, 0] * pixels[i, 0] + sides[turn, 1] * pixels[i, 1] > sides[turn, 2]:
                        in_sight[WINDOW, i] = 0.0
                        outside += missing[i]
                        break
        # a line in one of the directions parts the points in one way for each, one in any direction in one for each two
        # of them, and a circle in one for each three
        ways = DIRECTIONS if way < DIRECTIONS else max(0.5 * points, DIRECTIONS)
        before = odds[EDGE] if odds[EDGE] > -math.inf else 0.0
        odds[EDGE] = before + LOG_ODDS - math.log(ways * points)
        if outside > maximum * ABOVE_ROUNDING:
            before = odds[WINDOW] if odds[WINDOW] > -math.inf else 0.0
            odds[WINDOW] = before + LOG_ODDS - math.log(points * points * points / 6.0)
        else:  # what one edge hides already
            for i in range(first, end):
                in_sight[WINDOW, i] = 1.0

"""Refinement of relative poses on all points at once, each with every detection it may have: compiled.

Expectation maximisation: a detection counts for a source point by its share of what both may be. Each step moves the
rotation, the baseline and the scale of the inverse distances by the weighted normal equations of deviations from
epipolar lines and of logarithms of inverse distances. What a pose's error adds to the noise shrinks from step to step.

A minimal set takes the common direction for exact, so its pose fits no better than the direction is known. Where that
was measured, its two tilts move as well, under their prior.
"""

from __future__ import annotations

import math

from rootmatch.algebra.elimination import solve_in_place
from rootmatch.algebra.vector import (
    column,
    combination,
    cross,
    dot,
    fill_tilted_rotation,
    rotate_vector_about_y,
    slope_about_y,
    tangent_basis,
)
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, kernel, scalar
from rootmatch.samplers.two_views.likelihood import depth_along_line, epipolar_line, likelihood_ratio

MIN_SHARE = 1e-3
"""Share below which a pair of points moves no pose."""
DAMPING = 1e-9
"""Share of the diagonal that is added to it, against rounding. By construction."""
DIMENSIONS = 6
"""Rotation, two directions across the baseline, scale, and two tilts: those come last, as an exact direction has none.
"""


@scalar
def turned_bearing(pose, tilted, q):  # type: ignore[no-untyped-def]
    """A source bearing, rotated about y by a pose and then by the rotation (3, 3) of its tilts."""
    x, y, z = rotate_vector_about_y(pose[0], pose[1], q)
    return (
        tilted[0, 0] * x + tilted[0, 1] * y + tilted[0, 2] * z,
        tilted[1, 0] * x + tilted[1, 1] * y + tilted[1, 2] * z,
        tilted[2, 0] * x + tilted[2, 1] * y + tilted[2, 2] * z,
    )


@kernel
def all_ratios(views, pose, tilted, judge, blur, ratios):  # type: ignore[no-untyped-def]
    """Likelihood ratios (n, n') of all pairs at a pose."""
    inverse_density, possible = judge[0], judge[1]
    target, variance = views.target, views.target_variance
    x, y, z = target[0], target[1], target[2]
    t = (pose[2], pose[3], pose[4])
    inverse_scale = 1.0 / pose[5]
    for i in range(ratios.shape[0]):
        u = turned_bearing(pose, tilted, column(views.source, i))
        normal, across, forward, sine = epipolar_line(t, u)
        own = views.source_variance[i]
        to = ratios[i]
        allowed = possible[i]
        for k in range(ratios.shape[1]):
            to[k] = allowed[k] * likelihood_ratio(
                normal, across, forward, sine, x[k], y[k], z[k], own + variance[k], blur, inverse_scale,
                inverse_density[k],
            )  # fmt: skip


@kernel
def add_square(normal, side, jacobian, dimensions, value, weight):  # type: ignore[no-untyped-def]
    """Add weight · (value + J x)² to the normal equations."""
    for a in range(dimensions):
        wa = weight * jacobian[a]
        side[a] += wa * value
        for b in range(dimensions):
            normal[a, b] += wa * jacobian[b]


@kernel
def refinement_step(  # type: ignore[no-untyped-def]
    views, pose, tilt, tilted, tilt2, blur, breadth2, ratios, rows, columns, normal, side
):
    """Move a pose once, by pairs with their shares of ``ratios``; the sums of these are ``rows`` and ``columns``."""
    c, s = pose[0], pose[1]
    t = (pose[2], pose[3], pose[4])
    if views.planar:
        first, second = (-t[2], 0.0, t[0]), (0.0, 0.0, 0.0)
    else:
        first, second = tangent_basis(t[0], t[1], t[2])
    level = math.log(pose[5])
    dimensions = DIMENSIONS if tilt2 > 0.0 else DIMENSIONS - 2
    for a in range(dimensions):
        side[a] = 0.0
        for b in range(dimensions):
            normal[a, b] = 0.0
    for i in range(ratios.shape[0]):
        u = turned_bearing(pose, tilted, column(views.source, i))
        plane, across, forward, sine = epipolar_line(t, u)
        turns = slope_about_y(u), (0.0, -u[2], u[1]), (-u[1], u[0], 0.0)
        for n in range(ratios.shape[1]):
            share = ratios[i, n] / (1.0 + rows[i] + columns[n] - ratios[i, n])
            if share < MIN_SHARE:
                continue
            p = column(views.target, n)
            own = views.source_variance[i] + views.target_variance[n]
            inverse, product = 1.0 / sine, cross(u, p)
            jacobian = (
                inverse * dot(t, cross(turns[0], p)), inverse * dot(first, product), inverse * dot(second, product),
                0.0, inverse * dot(t, cross(turns[1], p)), inverse * dot(t, cross(turns[2], p)),
            )  # fmt: skip
            add_square(normal, side, jacobian, dimensions, dot(plane, p), share / (own + blur))
            _, size, parallax, ahead = depth_along_line(across, forward, p[0], p[1], p[2], sine, own)
            k, pu, pt = dot(t, u), dot(p, u), dot(p, t)
            root = parallax * parallax + own * sine * sine
            by_parallax, by_ahead = parallax / root, 1.0 / ahead
            # parallax = p · t − k p · u, ahead = p · u − k p · t
            f1, f2 = dot(first, u), dot(second, u)
            g1, g2 = dot(first, p), dot(second, p)
            jacobian = (
                slope_by_turn(turns[0], t, p, k, pu, pt, by_parallax, by_ahead),
                by_parallax * (g1 - f1 * pu) - by_ahead * (-f1 * pt - k * g1),
                by_parallax * (g2 - f2 * pu) - by_ahead * (-f2 * pt - k * g2),
                -1.0,
                slope_by_turn(turns[1], t, p, k, pu, pt, by_parallax, by_ahead),
                slope_by_turn(turns[2], t, p, k, pu, pt, by_parallax, by_ahead),
            )
            deviation = own * sine * sine * by_parallax * by_parallax
            add_square(normal, side, jacobian, dimensions, math.log(size) - level, share / (breadth2 + deviation))
    for a in range(4, dimensions):
        side[a] += tilt[a - 4] / tilt2
        normal[a, a] += 1.0 / tilt2
    for a in range(dimensions):
        normal[a, a] += DAMPING * normal[a, a] + 1e-300
    if views.planar:
        normal[2, 2] = 1.0
    solve_in_place(normal, side, dimensions)
    # no more than a radian, and no more than a factor e
    largest = abs(side[0])
    for a in range(1, dimensions):
        largest = max(largest, abs(side[a]))
    if not largest < 1e6:
        return
    scale = 1.0 / max(1.0, largest)
    angle = -scale * side[0]
    ca, sa = math.cos(angle), math.sin(angle)
    pose[0], pose[1] = c * ca - s * sa, s * ca + c * sa
    t = combination(1.0, t, 1.0, combination(-scale * side[1], first, -scale * side[2], second))
    size = 1.0 / math.sqrt(dot(t, t))
    pose[2], pose[3], pose[4] = size * t[0], size * t[1], size * t[2]
    pose[5] = math.exp(level - scale * side[3])
    for a in range(4, dimensions):
        tilt[a - 4] -= scale * side[a]


@scalar
def slope_by_turn(turn, t, p, k, pu, pt, by_parallax, by_ahead):  # type: ignore[no-untyped-def]
    """Derivative of the logarithm of an inverse distance where the source bearing moves by ``turn``."""
    turned_k, turned_p = dot(t, turn), dot(p, turn)
    return by_parallax * (-turned_k * pu - k * turned_p) - by_ahead * (turned_p - turned_k * pt)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def refine_poses(  # type: ignore[no-untyped-def]
    views, judge, blurs, breadth2, tilt2, start, end, poses, tilts, ratios, sums, tilted, normal, side
):
    """Refine poses ``start … end − 1`` of (K, FIELDS), and their tilts (K, 2), in place.

    Parameters
    ----------
    views, judge
        See `rootmatch.samplers.two_views.set_kernels.search_triples`.
    blurs : (T,) array
        Variance that the pose's error adds to the noise, of each step.
    breadth2 : float
        Variance of the logarithm of the inverse distances.
    tilt2 : float
        That of the tilts, 0 where they are none.
    ratios : (K, n, n') array
        Filled: likelihood ratios of all pairs at the refined poses, with the last of the blurs.
    sums, tilted, normal, side : (n + n',), (3, 3), (6, 6) and (6,) arrays
        Scratch.
    """
    views, judge, blurs, poses, tilts = borrow((views, judge, blurs, poses, tilts))
    ratios, sums, tilted, normal, side = borrow((ratios, sums, tilted, normal, side))
    n, n_target = ratios.shape[1], ratios.shape[2]
    rows, columns = sums[:n], sums[n:]
    for index in range(start, end):
        pose, tilt = poses[index], tilts[index]
        for turn in range(blurs.shape[0] + 1):
            blur = blurs[min(turn, blurs.shape[0] - 1)]
            fill_tilted_rotation(0.0, tilt, tilted)
            all_ratios(views, pose, tilted, judge, blur, ratios[index])
            if turn == blurs.shape[0]:
                break
            for i in range(n):
                rows[i] = 0.0
            for k in range(n_target):
                columns[k] = 0.0
            for i in range(n):
                for k in range(n_target):
                    rows[i] += ratios[index, i, k]
                    columns[k] += ratios[index, i, k]
            refinement_step(
                views, pose, tilt, tilted, tilt2, blur, breadth2, ratios[index], rows, columns, normal, side
            )  # fmt: skip

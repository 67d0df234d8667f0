"""Refinement of relative poses on all points at once, each with every detection it may have: compiled.

Expectation maximisation: a detection counts for a source point by its share of what both may be. Each step moves the
rotation, the baseline and the scale of the inverse distances by the weighted normal equations of deviations from
epipolar lines and of logarithms of inverse distances. What a pose's error adds to the noise shrinks from step to step.
"""

from __future__ import annotations

import math

from rootmatch.algebra.elimination import solve_in_place
from rootmatch.algebra.vector import column, combination, cross, dot, slope_about_y, tangent_basis
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, kernel
from rootmatch.samplers.two_views.likelihood import depth_along_line, epipolar_line, likelihood_ratio

LEAST_SHARE = 1e-3
"""Share below which a pair of points moves no pose."""
DAMPING = 1e-9
"""Share of the diagonal that is added to it, against rounding. By construction."""
DIMENSIONS = 4
"""Rotation, two directions across the baseline, scale."""


@kernel
def all_ratios(views, pose, judge, blur, ratios):  # type: ignore[no-untyped-def]
    """Likelihood ratios (n, n') of all pairs at a pose."""
    inverse_density, possible = judge[0], judge[1]
    target, variance = views.target, views.target_variance
    x, y, z = target[0], target[1], target[2]
    t = (pose[2], pose[3], pose[4])
    inverse_scale = 1.0 / pose[5]
    for i in range(ratios.shape[0]):
        _, normal, across, forward, sine = epipolar_line(pose[0], pose[1], t, column(views.source, i))
        own = views.source_variance[i]
        to = ratios[i]
        allowed = possible[i]
        for k in range(ratios.shape[1]):
            to[k] = allowed[k] * likelihood_ratio(
                normal, across, forward, sine, x[k], y[k], z[k], own + variance[k], blur, inverse_scale,
                inverse_density[k],
            )  # fmt: skip


@kernel
def add_square(normal, side, j0, j1, j2, j3, value, weight):  # type: ignore[no-untyped-def]
    """Add weight · (value + J x)² to the normal equations."""
    jacobian = (j0, j1, j2, j3)
    for a in range(DIMENSIONS):
        wa = weight * jacobian[a]
        side[a] += wa * value
        for b in range(DIMENSIONS):
            normal[a, b] += wa * jacobian[b]


@kernel
def refinement_step(views, pose, blur, breadth2, ratios, rows, columns, normal, side):  # type: ignore[no-untyped-def]
    """Move a pose once, by pairs with their shares of ``ratios``; the sums of these are ``rows`` and ``columns``."""
    c, s = pose[0], pose[1]
    t = (pose[2], pose[3], pose[4])
    if views.planar:
        first, second = (-t[2], 0.0, t[0]), (0.0, 0.0, 0.0)
    else:
        first, second = tangent_basis(t[0], t[1], t[2])
    level = math.log(pose[5])
    for a in range(DIMENSIONS):
        side[a] = 0.0
        for b in range(DIMENSIONS):
            normal[a, b] = 0.0
    for i in range(ratios.shape[0]):
        u, plane, across, forward, sine = epipolar_line(c, s, t, column(views.source, i))
        turned = slope_about_y(u)
        for n in range(ratios.shape[1]):
            share = ratios[i, n] / (1.0 + rows[i] + columns[n] - ratios[i, n])
            if share < LEAST_SHARE:
                continue
            p = column(views.target, n)
            own = views.source_variance[i] + views.target_variance[n]
            inverse = 1.0 / sine
            moved = cross(turned, p)
            product = cross(u, p)
            add_square(
                normal, side, inverse * dot(t, moved), inverse * dot(first, product),
                inverse * dot(second, product), 0.0, dot(plane, p), share / (own + blur),
            )  # fmt: skip
            _, size, parallax, ahead = depth_along_line(across, forward, p[0], p[1], p[2], sine, own)
            k, pu, pt = dot(t, u), dot(p, u), dot(p, t)
            turned_k, turned_p = dot(t, turned), dot(p, turned)
            root = parallax * parallax + own * sine * sine
            by_parallax, by_ahead = parallax / root, 1.0 / ahead
            # parallax = p · t − k p · u, ahead = p · u − k p · t
            f1, f2 = dot(first, u), dot(second, u)
            g1, g2 = dot(first, p), dot(second, p)
            j0 = by_parallax * (-turned_k * pu - k * turned_p) - by_ahead * (turned_p - turned_k * pt)
            j1 = by_parallax * (g1 - f1 * pu) - by_ahead * (-f1 * pt - k * g1)
            j2 = by_parallax * (g2 - f2 * pu) - by_ahead * (-f2 * pt - k * g2)
            deviation = own * sine * sine * by_parallax * by_parallax
            add_square(normal, side, j0, j1, j2, -1.0, math.log(size) - level, share / (breadth2 + deviation))
    for a in range(DIMENSIONS):
        normal[a, a] += DAMPING * normal[a, a] + 1e-300
    if views.planar:
        normal[2, 2] = 1.0
    solve_in_place(normal, side, DIMENSIONS)
    # no more than a radian, and no more than a factor e
    largest = max(max(abs(side[0]), abs(side[3])), max(abs(side[1]), abs(side[2])))
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


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def refine_poses(views, judge, blurs, breadth2, start, end, poses, ratios, sums, normal, side):  # type: ignore[no-untyped-def]
    """Refine poses ``start … end − 1`` of (K, FIELDS) in place.

    Parameters
    ----------
    views, judge
        See `rootmatch.samplers.two_views.set_kernels.search_triples`.
    blurs : (T,) array
        Variance that the pose's error adds to the noise, of each step.
    breadth2 : float
        Variance of the logarithm of the inverse distances.
    ratios : (K, n, n') array
        Filled: likelihood ratios of all pairs at the refined poses, with the last of the blurs.
    sums, normal, side : (n + n',), (4, 4) and (4,) arrays
        Scratch.
    """
    views, judge, blurs, poses = borrow((views, judge, blurs, poses))
    ratios, sums, normal, side = borrow((ratios, sums, normal, side))
    n, n_target = ratios.shape[1], ratios.shape[2]
    rows, columns = sums[:n], sums[n:]
    for index in range(start, end):
        for turn in range(blurs.shape[0] + 1):
            blur = blurs[min(turn, blurs.shape[0] - 1)]
            all_ratios(views, poses[index], judge, blur, ratios[index])
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
            refinement_step(views, poses[index], blur, breadth2, ratios[index], rows, columns, normal, side)

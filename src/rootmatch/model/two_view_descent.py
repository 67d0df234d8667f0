"""Fits of relative poses to matches of two views: a grid of rotations, and damped Gauss-Newton; compiled.

`rootmatch.model.two_view_fit` says what is fitted, and in which rounds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rootmatch.algebra.elimination import solve_damped
from rootmatch.algebra.vector import fill_tilted_rotation
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.two_view_odds import epipolar_variance, inverse_distance_terms
from rootmatch.problems.pose_fit.descent import SETTLED

IMPOSSIBLE = 6.0
"""Deviation, in σ, of a match that lies behind a camera, so that a fit can go on without it. A round value."""


@part
def least_axis(m, out):  # type: ignore[no-untyped-def]
    """Unit vector of the least eigenvalue of a symmetric form (xx, yy, zz, xy, xz, yz), by its adjugate's powers."""
    xx, yy, zz, xy, xz, yz = m[0], m[1], m[2], m[3], m[4], m[5]
    a, b, c = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    d, e, f = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
    for _ in range(4):
        size = 1.0 / max(a + b + c, 1e-300)
        a, b, c, d, e, f = size * a, size * b, size * c, size * d, size * e, size * f
        a, b, c, d, e, f = (
            a * a + d * d + e * e, d * d + b * b + f * f, e * e + f * f + c * c,
            a * d + d * b + e * f, a * e + d * f + e * c, d * e + b * f + f * c,
        )  # fmt: skip
    if a >= b and a >= c:
        x, y, z = a, d, e
    elif b >= c:
        x, y, z = d, b, f
    else:
        x, y, z = e, f, c
    size = math.sqrt(x * x + y * y + z * z)
    if size > 0.0:
        out[0], out[1], out[2] = x / size, y / size, z / size
    else:
        out[0], out[1], out[2] = 1.0, 0.0, 0.0


@part
def set_moves(t, planar, moves):  # type: ignore[no-untyped-def]
    """Directions in which t moves; their number is returned. See `TwoViewModel.bases`."""
    if planar:
        moves[0, 0], moves[0, 1], moves[0, 2] = t[2], 0.0, -t[0]
        return 1
    x, y, z = abs(t[0]), abs(t[1]), abs(t[2])
    e0, e1, e2 = 0.0, 0.0, 1.0
    if x <= y and x <= z:
        e0, e2 = 1.0, 0.0
    elif y <= z:
        e1, e2 = 1.0, 0.0
    a0, a1, a2 = t[1] * e2 - t[2] * e1, t[2] * e0 - t[0] * e2, t[0] * e1 - t[1] * e0
    size = 1.0 / math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    moves[0, 0], moves[0, 1], moves[0, 2] = size * a0, size * a1, size * a2
    moves[1, 0] = t[1] * moves[0, 2] - t[2] * moves[0, 1]
    moves[1, 1] = t[2] * moves[0, 0] - t[0] * moves[0, 2]
    moves[1, 2] = t[0] * moves[0, 1] - t[1] * moves[0, 0]
    return 2


@part
def normal_equations(views, model, state, spread, matches, weights, near, normal, side, scratch):  # type: ignore[no-untyped-def]
    """χ² of a pose, its normal equations and half its gradient; how the noise changes with the pose is left out."""
    first, second, first_variance, second_variance = views
    planar, tilt = model
    R, moves, du, dt, rows = scratch
    fill_tilted_rotation(state[0], state[4:6], R)
    t0, t1, t2 = state[1], state[2], state[3]
    count = set_moves(state[1:4], planar, moves)
    tilts = 2 if tilt > 0.0 else 0
    size = 2 + count + tilts
    for a in range(size):
        side[a] = 0.0
        for b in range(size):
            normal[a, b] = 0.0
        for b in range(3):
            du[a, b], dt[a, b] = 0.0, 0.0
    for d in range(count):
        dt[1 + d, 0], dt[1 + d, 1], dt[1 + d, 2] = moves[d, 0], moves[d, 1], moves[d, 2]
    mean, scene2 = math.exp(state[6]), math.exp(2.0 * spread)
    chi2 = 0.0
    for i in range(matches.shape[0]):
        column = matches[i]
        if column < 0:
            continue
        weight, v, w = weights[i], first_variance[i], second_variance[column]
        q0, q1, q2 = first[i, 0], first[i, 1], first[i, 2]
        p0, p1, p2 = second[column, 0], second[column, 1], second[column, 2]
        u0 = R[0, 0] * q0 + R[0, 1] * q1 + R[0, 2] * q2
        u1 = R[1, 0] * q0 + R[1, 1] * q1 + R[1, 2] * q2
        u2 = R[2, 0] * q0 + R[2, 1] * q1 + R[2, 2] * q2
        k, pt, pu = u0 * t0 + u1 * t1 + u2 * t2, p0 * t0 + p1 * t1 + p2 * t2, p0 * u0 + p1 * u1 + p2 * u2
        ahead, parallax, noise = pu - k * pt, pt - k * pu, v + w
        size2, across = epipolar_variance(k, pt, v, w, 1.0)
        width = 1.0 / math.sqrt(size2 * across)
        n0, n1, n2 = t1 * u2 - t2 * u1, t2 * u0 - t0 * u2, t0 * u1 - t1 * u0
        e = width * (n0 * p0 + n1 * p1 + n2 * p2)
        _, floor2, r2, mean2, spread2 = inverse_distance_terms(k, size2, parallax, ahead, noise, mean, scene2)
        own = 1.0 / math.sqrt(spread2)
        z = 0.5 * own * math.log(r2 / mean2)
        usable = ahead > 0.0 and abs(z) < math.inf
        by_side = 1.0 / math.sqrt(size2 * noise)
        behind = min(parallax, 0.0) * by_side
        if not near:
            z, behind = 0.0, 0.0
        elif not usable:
            z = IMPOSSIBLE
        # turns about y, and about x and z
        du[0, 0], du[0, 2] = u2, -u0
        if tilts > 0:
            du[1 + count, 1], du[1 + count, 2] = -u2, u1
            du[2 + count, 0], du[2 + count, 1] = -u1, u0
        for a in range(size - 1):
            x0, x1, x2, y0, y1, y2 = du[a, 0], du[a, 1], du[a, 2], dt[a, 0], dt[a, 1], dt[a, 2]
            dk = x0 * t0 + x1 * t1 + x2 * t2 + y0 * u0 + y1 * u1 + y2 * u2
            dpt, dpu = y0 * p0 + y1 * p1 + y2 * p2, x0 * p0 + x1 * p1 + x2 * p2
            triple = p0 * (t1 * x2 - t2 * x1 + y1 * u2 - y2 * u1)
            triple += p1 * (t2 * x0 - t0 * x2 + y2 * u0 - y0 * u2)
            triple += p2 * (t0 * x1 - t1 * x0 + y0 * u1 - y1 * u0)
            rows[0, a] = triple * width + e * width * width * (w * k * dk + v * pt * dpt)
            rows[1, a], rows[2, a] = 0.0, 0.0
            if near:
                moved = dpt - dk * pu - k * dpu
                if usable:
                    change = parallax / (ahead * ahead * r2) * moved
                    change -= (1.0 - floor2 / r2) * (dpu - dk * pt - k * dpt) / ahead
                    rows[1, a] = own * change if abs(change) < math.inf else 0.0
                if behind < 0.0:
                    rows[2, a] = moved * by_side
        last = size - 1
        rows[0, last], rows[1, last], rows[2, last] = 0.0, 0.0, 0.0
        if near and usable:
            rows[1, last] = -own * min(mean * mean / mean2, 1.0)
        weight *= weight
        chi2 += weight * (e * e + z * z + behind * behind)
        for a in range(size):
            side[a] += weight * (rows[0, a] * e + rows[1, a] * z + rows[2, a] * behind)
            for b in range(size):
                normal[a, b] += weight * (rows[0, a] * rows[0, b] + rows[1, a] * rows[1, b] + rows[2, a] * rows[2, b])
    for axis in range(tilts):
        a, value = 1 + count + axis, state[4 + axis] / tilt
        chi2 += value * value
        side[a] += value / tilt
        normal[a, a] += 1.0 / (tilt * tilt)
    return chi2


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def descend_poses(  # type: ignore[no-untyped-def]
    views, model, states, spreads, matches, weights, near, steps, normals, scratch, more
):
    """Move poses to the bottom of the χ² of their matches.

    Parameters
    ----------
    views : tuple
        Bearings (n, 3) and (n', 3), and their variances (n,) and (n',).
    model : tuple
        Whether t is horizontal, and σ of the tilts in radians, 0 for none.
    states : (K, 7) array
        Rotation about y, unit baseline, two tilts and μ; moved.
    spreads : (K,) array
        log τ.
    matches, weights : (K, n) arrays
        Detections, −1 for none, and the roots of their weights.
    near : bool
        Whether inverse distances count.
    steps : int
        Most of them.
    normals : (K, p, p) array
        Filled: normal equations of turn, directions of t, tilts where they are unknown, and μ.
    scratch, more : tuples
        See `descent_scratch`.
    """
    views, states, spreads, matches, weights = borrow((views, states, spreads, matches, weights))
    normals, scratch, more = borrow((normals, scratch, more))
    planar, tilt = model
    work, side, side2, step, trial, normal2 = more
    moves = scratch[1]
    size = normals.shape[1]
    for index in range(states.shape[0]):
        state, normal, own, weight = states[index], normals[index], matches[index], weights[index]
        chi2 = normal_equations(views, model, state, spreads[index], own, weight, near, normal, side, scratch)
        damping = 1e-4
        for _ in range(steps):
            if not 0.0 < chi2 < math.inf:
                break
            if not solve_damped(normal, side, damping, size, work, step):
                damping = 10.0 * max(damping, 1e-6)
                continue
            promised = 0.0
            for a in range(size):
                promised += side[a] * step[a]
            count = set_moves(state[1:4], planar, moves)
            for a in range(7):
                trial[a] = state[a]
            trial[0] -= step[0]
            for d in range(count):
                for a in range(3):
                    trial[1 + a] -= step[1 + d] * moves[d, a]
            length = 1.0 / math.sqrt(trial[1] * trial[1] + trial[2] * trial[2] + trial[3] * trial[3])
            for a in range(1, 4):
                trial[a] *= length
            if tilt > 0.0:
                trial[4] -= step[1 + count]
                trial[5] -= step[2 + count]
            trial[6] -= step[size - 1]
            reached = normal_equations(views, model, trial, spreads[index], own, weight, near, normal2, side2, scratch)
            settled = promised <= SETTLED * chi2 and damping <= 1e-3
            if reached <= chi2:
                chi2 = reached
                for a in range(7):
                    state[a] = trial[a]
                for a in range(size):
                    side[a] = side2[a]
                    for b in range(size):
                        normal[a, b] = normal2[a, b]
                damping = max(0.1 * damping, 1e-12)
            else:
                damping = 10.0 * max(damping, 1e-6)
            if settled:
                break


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def scan_rotations(views, planar, matches, doubted, totals, axes):  # type: ignore[no-untyped-def]
    """Deviations (K, angles) of matches (K, n) at rotations about y, and the baselines (K, angles, 3) that fit best.

    A deviation e counts log(1 + e² / ``doubted``²); ``views`` as of `descend_poses`.
    """
    views, matches, totals, axes = borrow((views, matches, totals, axes))
    first, second, first_variance, second_variance = views
    angles = totals.shape[1]
    for index in range(matches.shape[0]):
        for turn in range(angles):
            angle = 2.0 * math.pi * turn / angles
            c, s = math.cos(angle), math.sin(angle)
            t = axes[index, turn]
            xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(matches.shape[1]):
                column = matches[index, i]
                if column >= 0:
                    u0, u1, u2 = c * first[i, 0] + s * first[i, 2], first[i, 1], c * first[i, 2] - s * first[i, 0]
                    p0, p1, p2 = second[column, 0], second[column, 1], second[column, 2]
                    n0, n1, n2 = u1 * p2 - u2 * p1, u2 * p0 - u0 * p2, u0 * p1 - u1 * p0
                    xx, yy, zz, xy, xz, yz = (
                        xx + n0 * n0, yy + n1 * n1, zz + n2 * n2, xy + n0 * n1, xz + n0 * n2, yz + n1 * n2,
                    )  # fmt: skip
            if planar:
                # across the axis of the largest eigenvalue
                across = 0.5 * math.atan2(2.0 * xz, xx - zz)
                t[0], t[1], t[2] = -math.sin(across), 0.0, math.cos(across)
            else:
                least_axis((xx, yy, zz, xy, xz, yz), t)
            total = 0.0
            for i in range(matches.shape[1]):
                column = matches[index, i]
                if column >= 0:
                    u0, u1, u2 = c * first[i, 0] + s * first[i, 2], first[i, 1], c * first[i, 2] - s * first[i, 0]
                    p0, p1, p2 = second[column, 0], second[column, 1], second[column, 2]
                    k, pt = u0 * t[0] + u1 * t[1] + u2 * t[2], p0 * t[0] + p1 * t[1] + p2 * t[2]
                    size2, across = epipolar_variance(k, pt, first_variance[i], second_variance[column], 1.0)
                    triple = t[0] * (u1 * p2 - u2 * p1) + t[1] * (u2 * p0 - u0 * p2) + t[2] * (u0 * p1 - u1 * p0)
                    total += math.log1p(triple * triple / (size2 * across * doubted * doubted))
            totals[index, turn] = total


def descent_scratch() -> tuple[Any, Any]:
    """Scratch of `descend_poses`."""
    p = 6
    equations = np.empty((3, 3)), np.empty((2, 3)), np.empty((p, 3)), np.empty((p, 3)), np.empty((3, p))
    descent = np.empty((p, p)), np.empty(p), np.empty(p), np.empty(p), np.empty(7), np.empty((p, p))
    return equations, descent

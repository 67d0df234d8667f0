"""Relative poses of many assignments: starts on a grid of rotations, and damped Gauss-Newton from them, compiled.

A pose is a rotation about the common direction, two angles that move the translation from its base, and two tilts where
the direction is noisy. `rootmatch.problems.pose_fit.relative` says what is fitted, and weighs what is found here.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.problems.pose_fit.relative_deviation import motion, point
from rootmatch.problems.pose_fit.relative_steps import ALONG, DELTA

CUT = 25.0
"""Squared deviation at which a point stops counting when starts are compared. Not tuned: (5 σ)²."""
FIRST_DAMPING, LESS, MORE = 1e-4, 0.1, 30.0
"""Levenberg's damping, and its factors after a step down and one up. Not tuned."""


@part
def squares(views, pose, base, prior, dimensions, answer, values, move):  # type: ignore[no-untyped-def]
    """χ² and the sum of squared parallaxes; ``values`` (3, n) filled with deviation, parallax and width."""
    motion(pose, base, dimensions, move)
    chi2, sizes = 0.0, 0.0
    for i in range(answer.shape[0]):
        k = answer[i]
        if k < 0:
            continue
        value, along, width = point(views, move, i, k)
        values[0, i], values[1, i], values[2, i] = value, along, width
        chi2 += value * value
        sizes += along * along + ALONG * ALONG * width * width
    for a in range(dimensions):
        chi2 += pose[a] * pose[a] * prior[a]
    return chi2, sizes


@part
def equations(views, pose, base, prior, dimensions, answer, values, weight, scratch):  # type: ignore[no-untyped-def]
    """Normal equations and their right side, about ``values`` of this pose; ``weight`` of a squared parallax."""
    normal, side, slopes, moves, moved = scratch
    for a in range(dimensions):
        side[a] = pose[a] * prior[a]
        for b in range(dimensions):
            normal[a, b] = prior[a] if a == b else 0.0
        for b in range(dimensions):
            moved[b] = pose[b]
        moved[a] += DELTA
        motion(moved, base, dimensions, moves[a])
    for i in range(answer.shape[0]):
        k = answer[i]
        if k < 0:
            continue
        for a in range(dimensions):
            value, along, _ = point(views, moves[a], i, k)
            slopes[0, a] = (value - values[0, i]) / DELTA
            slopes[1, a] = (along - values[1, i]) / DELTA
        for a in range(dimensions):
            across, along = slopes[0, a], weight * slopes[1, a]
            side[a] += across * values[0, i] + along * values[1, i]
            for b in range(dimensions):
                normal[a, b] += across * slopes[0, b] + along * slopes[1, b]


@part
def solved(normal, side, damping, dimensions, work, out):  # type: ignore[no-untyped-def]
    """The damped symmetric system, by elimination; whether it has a finite solution."""
    for a in range(dimensions):
        for b in range(dimensions):
            work[a, b] = normal[a, b]
        work[a, a] = work[a, a] * (1.0 + damping) + 1e-300
        out[a] = side[a]
    for a in range(dimensions):
        pivot = 1.0 / work[a, a]
        for b in range(a + 1, dimensions):
            f = work[b, a] * pivot
            for d in range(a, dimensions):
                work[b, d] -= f * work[a, d]
            out[b] -= f * out[a]
    finite = True
    for back in range(dimensions):
        a = dimensions - 1 - back
        total = out[a]
        for b in range(a + 1, dimensions):
            total -= work[a, b] * out[b]
        out[a] = total / work[a, a]
        finite = finite and abs(out[a]) < 1e6
    return finite


@part
def descend(views, pose, base, prior, dimensions, answer, count, share, steps, settled, values, scratch, more):  # type: ignore[no-untyped-def]
    """Move a pose to the bottom of χ² + share · count · log(sum of squared parallaxes); its objective."""
    normal, side, _, _, _ = scratch
    work, change, trial, tried, move = more
    chi2, sizes = squares(views, pose, base, prior, dimensions, answer, values, move)
    lowest = chi2 + share * count * math.log(sizes)
    damping = FIRST_DAMPING
    fresh = False
    for _ in range(steps):
        if not fresh:
            equations(
                views, pose, base, prior, dimensions, answer, values, share * count / sizes, scratch
            )  # fmt: skip
            fresh = True
        if not solved(normal, side, damping, dimensions, work, change):
            damping *= MORE
            continue
        for a in range(dimensions):
            trial[a] = pose[a] - change[a]
        chi2, reached_sizes = squares(views, trial, base, prior, dimensions, answer, tried, move)
        reached = chi2 + share * count * math.log(reached_sizes)
        if reached <= lowest:
            gained = lowest - reached
            lowest, sizes, fresh = reached, reached_sizes, False
            damping *= LESS
            for a in range(dimensions):
                pose[a] = trial[a]
            for i in range(answer.shape[0]):
                values[0, i], values[1, i], values[2, i] = tried[0, i], tried[1, i], tried[2, i]
            if gained <= settled:
                break
        else:
            damping *= MORE
    return lowest


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
def grid_of_rotations(views, answer, move, form, totals, axes):  # type: ignore[no-untyped-def]
    """Truncated χ² (angles,) and translation (angles, 3) of the least algebraic deviation at rotations all around."""
    first, second = views[0], views[1]
    angles = totals.shape[0]
    for turn in range(angles):
        angle = 2.0 * math.pi * turn / angles
        c, s = math.cos(angle), math.sin(angle)
        for a in range(6):
            form[a] = 0.0
        for i in range(answer.shape[0]):
            k = answer[i]
            if k < 0:
                continue
            u0, u1, u2 = c * first[i, 0] + s * first[i, 2], first[i, 1], c * first[i, 2] - s * first[i, 0]
            p0, p1, p2 = second[k, 0], second[k, 1], second[k, 2]
            n0, n1, n2 = u1 * p2 - u2 * p1, u2 * p0 - u0 * p2, u0 * p1 - u1 * p0
            form[0] += n0 * n0
            form[1] += n1 * n1
            form[2] += n2 * n2
            form[3] += n0 * n1
            form[4] += n0 * n2
            form[5] += n1 * n2
        least_axis(form, axes[turn])
        move[0], move[1], move[2] = c, 0.0, s
        move[3], move[4], move[5] = 0.0, 1.0, 0.0
        move[6], move[7], move[8] = -s, 0.0, c
        move[9], move[10], move[11] = axes[turn, 0], axes[turn, 1], axes[turn, 2]
        total = 0.0
        for i in range(answer.shape[0]):
            if answer[i] >= 0:
                value, _, _ = point(views, move, i, answer[i])
                total += min(value * value, CUT)
        totals[turn] = total


@part
def set_base(t, base):  # type: ignore[no-untyped-def]
    """The translation and two directions across it, the first beginning with the axis to which it is least aligned."""
    x, y, z = abs(t[0]), abs(t[1]), abs(t[2])
    e0, e1, e2 = 0.0, 0.0, 1.0
    if x <= y and x <= z:
        e0, e2 = 1.0, 0.0
    elif y <= z:
        e1, e2 = 1.0, 0.0
    a0, a1, a2 = t[1] * e2 - t[2] * e1, t[2] * e0 - t[0] * e2, t[0] * e1 - t[1] * e0
    size = 1.0 / math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    a0, a1, a2 = size * a0, size * a1, size * a2
    base[0, 0], base[0, 1], base[0, 2] = t[0], t[1], t[2]
    base[1, 0], base[1, 1], base[1, 2] = a0, a1, a2
    base[2, 0], base[2, 1], base[2, 2] = t[1] * a2 - t[2] * a1, t[2] * a0 - t[0] * a2, t[0] * a1 - t[1] * a0


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fit_assignments(  # type: ignore[no-untyped-def]
    views, prior, assignments, start, end, steps, settled, poses, bases, objectives, chi2s, normals, widths, sides,
    totals, minima, axes, alone, values, scratch, more,
):  # fmt: skip
    """Fit assignments ``start … end − 1`` of (K, n) from the best starts.

    Parameters
    ----------
    views : tuple
        Rays (n, 3) and (n', 3), their axes (n, 3, 2) and (n', 3, 2), σ (n,) and (n',), and the focal length.
    prior : (p,) array
        Weight of a pose's squared entries: p is 3, or 5 with tilts.
    steps, settled : int, float
        Most steps of a descent, and the gain that ends it.
    poses, bases : (K, S, p) and (K, S, 3, 3) arrays
        Filled: the fits from S starts; entries beyond the starts that there are repeat the first.
    objectives, chi2s : (K, S) and (K,) arrays
        Filled: of the fit to deviations and parallaxes, and the least χ² of deviations alone.
    normals : (K, S, p, p) array
        Filled: normal equations of the fit.
    widths, sides : (K, S) and (K, S, 2) arrays
        Filled: sum of the logarithms of the σ across the lines, and minus the log probability of points behind a
        camera, for t and for −t.
    totals, minima, axes, alone, values, scratch, more
        Scratch; see `scratch_of`.
    """
    views, prior, assignments, poses, bases = borrowed((views, prior, assignments, poses, bases))
    objectives, chi2s, normals, widths, sides = borrowed((objectives, chi2s, normals, widths, sides))
    totals, minima, axes, alone = borrowed((totals, minima, axes, alone))
    values, scratch, more = borrowed((values, scratch, more))
    dimensions, angles = prior.shape[0], totals.shape[0]
    for index in range(start, end):
        answer = assignments[index]
        count = 0.0
        for i in range(answer.shape[0]):
            count += 1.0 if answer[i] >= 0 else 0.0
        grid_of_rotations(views, answer, more[4], more[2], totals, axes)
        for turn in range(angles):
            below = totals[turn - 1] if turn > 0 else totals[angles - 1]
            above = totals[turn + 1] if turn + 1 < angles else totals[0]
            minima[turn] = totals[turn] if totals[turn] <= min(below, above) else math.inf
        least = math.inf
        for rank in range(poses.shape[1]):
            best = 0
            for turn in range(angles):
                if minima[turn] < minima[best]:
                    best = turn
            pose, base = poses[index, rank], bases[index, rank]
            if rank > 0 and minima[best] == math.inf:
                # fewer minima than starts
                for a in range(dimensions):
                    pose[a] = poses[index, 0, a]
                    for b in range(dimensions):
                        normals[index, rank, a, b] = normals[index, 0, a, b]
                for a in range(3):
                    for b in range(3):
                        base[a, b] = bases[index, 0, a, b]
                objectives[index, rank], widths[index, rank] = objectives[index, 0], widths[index, 0]
                sides[index, rank, 0], sides[index, rank, 1] = sides[index, 0, 0], sides[index, 0, 1]
                continue
            for a in range(dimensions):
                pose[a] = 0.0
            pose[0] = 2.0 * math.pi * best / angles
            set_base(axes[best], base)
            minima[best] = math.inf
            objectives[index, rank] = descend(
                views, pose, base, prior, dimensions, answer, count, 1.0, steps, settled, values, scratch, more
            )
            chi2, sizes = squares(views, pose, base, prior, dimensions, answer, values, more[4])
            least = min(least, chi2)
            equations(views, pose, base, prior, dimensions, answer, values, count / sizes, scratch)
            width, front, back = 0.0, 0.0, 0.0
            for i in range(answer.shape[0]):
                if answer[i] >= 0:
                    width += math.log(values[2, i])
                    along = values[1, i] / (ALONG * values[2, i])
                    front += 0.5 * min(along, 0.0) ** 2
                    back += 0.5 * max(along, 0.0) ** 2
            widths[index, rank], sides[index, rank, 0], sides[index, rank, 1] = width, front, back
            for a in range(dimensions):
                for b in range(dimensions):
                    normals[index, rank, a, b] = scratch[0][a, b]
            # the fit to deviations alone
            for a in range(dimensions):
                alone[a] = 0.0
            alone[0] = 2.0 * math.pi * best / angles
            chi2 = descend(
                views, alone, base, prior, dimensions, answer, count, 0.0, steps, settled, values, scratch, more
            )  # fmt: skip
            least = min(least, chi2)
        chi2s[index] = least


def scratch_of(n: int, dimensions: int, angles: int) -> tuple[Any, ...]:
    """Scratch of `fit_assignments` for n source points, poses of so many numbers and starts on so many angles."""
    p = dimensions
    equations = np.zeros((p, p)), np.zeros(p), np.zeros((2, p)), np.zeros((p, 12)), np.zeros(p)
    descent = np.zeros((p, p)), np.zeros(p), np.zeros(6), np.zeros((3, n)), np.zeros(12)
    return np.zeros(angles), np.zeros(angles), np.zeros((angles, 3)), np.zeros(p), np.zeros((3, n)), equations, descent

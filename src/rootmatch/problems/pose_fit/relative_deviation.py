"""Deviation and parallax of one correspondence under a relative pose, compiled."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part, scalar


@part
def motion(pose, base, dimensions, out):  # type: ignore[no-untyped-def]
    """Rotation (rows, 0 to 8) and unit translation (9 to 11) of a pose."""
    c, s = math.cos(pose[0]), math.sin(pose[0])
    x, z = 0.0, 0.0
    if dimensions > 3:
        x, z = pose[3], pose[4]
    # (1 + [tilt]) R
    out[0], out[1], out[2] = c, -z, s
    out[3], out[4], out[5] = z * c + x * s, 1.0, z * s - x * c
    out[6], out[7], out[8] = -s, x, c
    tx = base[0, 0] + pose[1] * base[1, 0] + pose[2] * base[2, 0]
    ty = base[0, 1] + pose[1] * base[1, 1] + pose[2] * base[2, 1]
    tz = base[0, 2] + pose[1] * base[1, 2] + pose[2] * base[2, 2]
    inverse = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
    out[9], out[10], out[11] = inverse * tx, inverse * ty, inverse * tz


@scalar
def square2(x, y, z, axes):  # type: ignore[no-untyped-def]
    """Squared length of a vector times axes (3, 2)."""
    a = x * axes[0, 0] + y * axes[1, 0] + z * axes[2, 0]
    b = x * axes[0, 1] + y * axes[1, 1] + z * axes[2, 1]
    return a * a + b * b


@part
def point(views, move, i, k):  # type: ignore[no-untyped-def]
    """Deviation in σ, parallax in pixels and σ across the line in pixels, of one correspondence."""
    first, second, first_axes, second_axes, first_sigma, second_sigma, focal = views
    q0, q1, q2 = first[i, 0], first[i, 1], first[i, 2]
    p0, p1, p2 = second[k, 0], second[k, 1], second[k, 2]
    t0, t1, t2 = move[9], move[10], move[11]
    u0 = move[0] * q0 + move[1] * q1 + move[2] * q2
    u1 = move[3] * q0 + move[4] * q1 + move[5] * q2
    u2 = move[6] * q0 + move[7] * q1 + move[8] * q2
    l0, l1, l2 = t1 * u2 - t2 * u1, t2 * u0 - t0 * u2, t0 * u1 - t1 * u0
    by_second = square2(l0, l1, l2, second_axes[k])
    b0, b1, b2 = p1 * t2 - p2 * t1, p2 * t0 - p0 * t2, p0 * t1 - p1 * t0
    by_first = square2(
        move[0] * b0 + move[3] * b1 + move[6] * b2,
        move[1] * b0 + move[4] * b1 + move[7] * b2,
        move[2] * b0 + move[5] * b1 + move[8] * b2,
        first_axes[i],
    )
    sigma1, sigma2 = first_sigma[i], second_sigma[k]
    deviation = math.sqrt(max(by_second * sigma2 * sigma2 + by_first * sigma1 * sigma1, 1e-300))
    value = (p0 * l0 + p1 * l1 + p2 * l2) / deviation
    width = deviation / math.sqrt(max(by_second, 1e-300))
    inverse = 1.0 / math.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
    f0, f1, f2 = inverse * u0, inverse * u1, inverse * u2
    k_ = f0 * t0 + f1 * t1 + f2 * t2
    a0, a1, a2 = t0 - k_ * f0, t1 - k_ * f1, t2 - k_ * f2
    size = math.sqrt(max(a0 * a0 + a1 * a1 + a2 * a2, 1e-300))
    along = focal * math.atan2((p0 * a0 + p1 * a1 + p2 * a2) / size, p0 * f0 + p1 * f1 + p2 * f2)
    return value, along, width

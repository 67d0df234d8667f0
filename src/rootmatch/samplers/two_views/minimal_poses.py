"""Relative poses of minimal sets between two views: three correspondences, or two where the baseline is planar.

The first images are fixed; the last runs over every detection, in straight-line arithmetic that vectorises.
"""

from __future__ import annotations

import math

from rootmatch.algebra.vector import column, cross, dot, rotate_vector_about_y
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.three_plus_one.normalised_residual import longest_cross, roots
from rootmatch.problems.three_plus_one.quartic import branch, coefficients, stem
from rootmatch.samplers.two_views.likelihood import depth_along_line, epipolar_line

ROOTS = 4
"""Most solutions of a minimal set."""
FIELDS = 6
"""Numbers of a solution: cosine and sine of the rotation, the unit baseline, and the scale of the inverse distances,
which is 0 where there is no solution."""


@scalar
def parallax_sign(t, u, k):  # type: ignore[no-untyped-def]
    """Parallax of a correspondence, whose sign says which of t and −t has it in front."""
    return dot(t, k) - dot(t, u) * dot(u, k)


@scalar
def fits_pose(c, s, t, q, p, own, gate2):  # type: ignore[no-untyped-def]
    """Whether a correspondence fits a pose, and its inverse distance."""
    normal, across, forward, sine = epipolar_line(t, rotate_vector_about_y(c, s, q))
    e = dot(normal, p)
    front, size, _, _ = depth_along_line(across, forward, p[0], p[1], p[2], sine, own)
    return front & (e * e < gate2 * own), size


@scalar
def triple_pose(c, s, a, k, b, l, d, m, ak, bl, dm, gate2, spread):  # type: ignore[no-untyped-def]  # noqa: E741
    """Baseline and scale of a ↔ k, b ↔ l, d ↔ m with variances ak, bl, dm at one rotation; scale 0 if they do not fit.

    Their inverse distances must lie within a factor ``spread``; the scale is the middle one.
    """
    u1, u2, u3 = rotate_vector_about_y(c, s, a), rotate_vector_about_y(c, s, b), rotate_vector_about_y(c, s, d)
    t, _ = longest_cross(cross(u1, k), cross(u2, l), cross(u3, m))
    side = parallax_sign(t, u1, k) + parallax_sign(t, u2, l) + parallax_sign(t, u3, m)
    sign = 1.0 if side > 0.0 else -1.0
    t = (sign * t[0], sign * t[1], sign * t[2])
    fits1, r1 = fits_pose(c, s, t, a, k, ak, gate2)
    fits2, r2 = fits_pose(c, s, t, b, l, bl, gate2)
    fits3, r3 = fits_pose(c, s, t, d, m, dm, gate2)
    high, low = max(r1, max(r2, r3)), min(r1, min(r2, r3))
    fits = fits1 & fits2 & fits3 & (high < spread * low)
    return t, (r1 + r2 + r3 - high - low if fits else 0.0)


@kernel
def triple_poses(views, i, first, second, gate2, spread, panel):  # type: ignore[no-untyped-def]
    """Poses of three source points, the first two with images ``first`` and ``second``, the third with every one.

    ``panel`` (ROOTS, FIELDS, n') is filled.
    """
    q, p = views.source, views.target
    dq, dp = views.source_variance, views.target_variance
    a, b, d = column(q, i[0]), column(q, i[1]), column(q, i[2])
    k, l = column(p, first), column(p, second)  # noqa: E741
    ak, bl, da = dq[i[0]] + dp[first], dq[i[1]] + dp[second], dq[i[2]]
    leaves = branch(stem(a, k, b, l), d)
    x, y, z = p[0], p[1], p[2]
    for n in range(panel.shape[2]):
        angles, _, sign = roots(coefficients(leaves, (x[n], y[n], z[n])))
        panel[0, 0, n], panel[1, 0, n], panel[2, 0, n], panel[3, 0, n] = angles
        panel[0, 1, n] = sign
    for n in range(panel.shape[2]):
        panel[1, 1, n], panel[2, 1, n], panel[3, 1, n] = panel[0, 1, n], panel[0, 1, n], panel[0, 1, n]
    for root in range(ROOTS):
        to = panel[root]
        for n in range(panel.shape[2]):
            half = to[0, n]
            scale = 1.0 / (1.0 + half * half)
            c, s = to[1, n] * (1.0 - half * half) * scale, 2.0 * half * scale
            t, size = triple_pose(c, s, a, k, b, l, d, (x[n], y[n], z[n]), ak, bl, da + dp[n], gate2, spread)
            to[0, n], to[1, n] = c, s
            to[2, n], to[3, n], to[4, n] = t
            to[5, n] = size
    for root in range(ROOTS):
        panel[root, 5, first] = 0.0
        panel[root, 5, second] = 0.0


@scalar
def flat_line(c, s, q, p):  # type: ignore[no-untyped-def]
    """The baseline in the plane across y that one correspondence leaves, not scaled: across R q × p."""
    u = rotate_vector_about_y(c, s, q)
    return u[0] * p[1] - u[1] * p[0], 0.0, u[2] * p[1] - u[1] * p[2]


@scalar
def flat_rotations(a, k, b, l):  # type: ignore[no-untyped-def]  # noqa: E741
    """Cosine and sine of the two rotations for which two correspondences leave the same baseline across y.

    With z = e^(−iθ) and w = p_y Q z − q_y P for Q = q_x + i q_z, P = p_x + i p_z, the baseline of each is along w, and
    they agree where Im(w₁ w̄₂) = C + Im(D z) = 0. Where noise leaves no rotation it is the nearest one, twice.
    """
    # products of complex numbers: Q1 Q2*, P1 P2*, Q1 P2*, and P1* Q2 for B*
    constant = k[1] * l[1] * (a[2] * b[0] - a[0] * b[2]) + a[1] * b[1] * (k[2] * l[0] - k[0] * l[2])
    f, g = -k[1] * b[1], a[1] * l[1]
    real = f * (a[0] * l[0] + a[2] * l[2]) + g * (k[0] * b[0] + k[2] * b[2])
    imaginary = f * (a[2] * l[0] - a[0] * l[2]) + g * (k[0] * b[2] - k[2] * b[0])
    square = real * real + imaginary * imaginary
    high = math.sqrt(max(square - constant * constant, 0.0))
    low = -constant if constant * constant <= square else (-math.sqrt(square) if constant > 0.0 else math.sqrt(square))
    inverse = 1.0 / square
    c0, s0 = inverse * (low * imaginary + high * real), inverse * (high * imaginary - low * real)
    c1, s1 = inverse * (low * imaginary - high * real), inverse * (-high * imaginary - low * real)
    return c0, s0, c1, s1


@scalar
def pair_pose(c, s, a, k, b, l, ak, bl, gate2, spread):  # type: ignore[no-untyped-def]  # noqa: E741
    """Baseline and scale of two correspondences, as `triple_pose`, for a baseline across y."""
    v, w = flat_line(c, s, a, k), flat_line(c, s, b, l)
    vv, ww = dot(v, v), dot(w, w)
    longer = vv > ww
    scale = 1.0 / math.sqrt(max(vv, ww))
    t = (scale * (v[0] if longer else w[0]), 0.0, scale * (v[2] if longer else w[2]))
    side = parallax_sign(t, rotate_vector_about_y(c, s, a), k) + parallax_sign(t, rotate_vector_about_y(c, s, b), l)
    sign = 1.0 if side > 0.0 else -1.0
    t = (sign * t[0], 0.0, sign * t[2])
    fits1, r1 = fits_pose(c, s, t, a, k, ak, gate2)
    fits2, r2 = fits_pose(c, s, t, b, l, bl, gate2)
    fits = fits1 & fits2 & (max(r1, r2) < spread * min(r1, r2))
    return t, (math.sqrt(r1 * r2) if fits else 0.0)


@kernel
def pair_poses(views, i, first, gate2, spread, panel):  # type: ignore[no-untyped-def]
    """Poses of two source points, the first with the image ``first``, the second with every one; see `triple_poses`."""
    q, p = views.source, views.target
    dq, dp = views.source_variance, views.target_variance
    a, b, k = column(q, i[0]), column(q, i[1]), column(p, first)
    ak, da = dq[i[0]] + dp[first], dq[i[1]]
    x, y, z = p[0], p[1], p[2]
    for n in range(panel.shape[2]):
        m = (x[n], y[n], z[n])
        c0, s0, c1, s1 = flat_rotations(a, k, b, m)
        t, size = pair_pose(c0, s0, a, k, b, m, ak, da + dp[n], gate2, spread)
        panel[0, 0, n], panel[0, 1, n] = c0, s0
        panel[0, 2, n], panel[0, 3, n], panel[0, 4, n] = t
        panel[0, 5, n] = size
        t, size = pair_pose(c1, s1, a, k, b, m, ak, da + dp[n], gate2, spread)
        panel[1, 0, n], panel[1, 1, n] = c1, s1
        panel[1, 2, n], panel[1, 3, n], panel[1, 4, n] = t
        panel[1, 5, n] = size
        panel[2, 5, n], panel[3, 5, n] = 0.0, 0.0
    for root in range(ROOTS):
        panel[root, 5, first] = 0.0

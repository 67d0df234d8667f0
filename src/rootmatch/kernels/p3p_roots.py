"""The solutions of a P3P triple: roots of its quartic, polished on the distance equations they came from."""

from __future__ import annotations

import numpy as np

from rootmatch.kernels.dispatch import scalar
from rootmatch.kernels.p3p import STEP, quadratics, quartic


@scalar
def quartic_roots(c4, c3, c2, c1, c0):  # type: ignore[no-untyped-def]
    """Real roots by Ferrari's factors; NaN where there is none, a nearly real pair at its real part, twice."""
    inverse = 1.0 / c4
    b = 0.25 * c3 * inverse
    b2 = b * b
    p = c2 * inverse - 6.0 * b2
    q = c1 * inverse - 2.0 * c2 * inverse * b + 8.0 * b2 * b
    r = c0 * inverse - c1 * inverse * b + c2 * inverse * b2 - 3.0 * b2 * b2
    # greatest root of the resolvent w³ + 2 p w² + (p² − 4 r) w − q²
    P = -p * p / 3.0 - 4.0 * r
    Q = p * (8.0 * r / 3.0 - 2.0 * p * p / 27.0) - q * q
    discriminant = 0.25 * Q * Q + P * P * P / 27.0
    if discriminant > 0.0:
        half = np.sqrt(discriminant)
        side = np.cbrt(0.5 * abs(Q) + half)
        side = -side if Q > 0.0 else side
        w = side - P / (3.0 * side) - 2.0 * p / 3.0
    else:
        m = np.sqrt(-P / 3.0)
        cosine = min(1.0, max(-1.0, -0.5 * Q / (m * m * m)))
        w = 2.0 * m * np.cos(np.arccos(cosine) / 3.0) - 2.0 * p / 3.0
    w -= (((w + 2.0 * p) * w + (p * p - 4.0 * r)) * w - q * q) / ((3.0 * w + 4.0 * p) * w + (p * p - 4.0 * r))
    a = np.sqrt(max(w, 1e-300))
    s = q / a
    near = -1e-3 * (abs(w) + abs(p))
    d1 = -w - 2.0 * p + 2.0 * s
    d2 = -w - 2.0 * p - 2.0 * s
    h1 = np.sqrt(max(d1, 0.0)) if d1 > near else np.nan
    h2 = np.sqrt(max(d2, 0.0)) if d2 > near else np.nan
    return 0.5 * (h1 - a) - b, 0.5 * (-h1 - a) - b, 0.5 * (a + h2) - b, 0.5 * (a - h2) - b


@scalar
def polish(A, B, C, hab, hbc, hca, x, y):  # type: ignore[no-untyped-def]
    """One Newton step of the depth ratios x = b/a, y = c/a on the two equations they must satisfy."""
    inverse = 1.0 / A
    beta = B * inverse
    gamma = C * inverse
    X = x - 1.0
    Y = y - 1.0
    w = X * X + 2.0 * hab * x
    wx = 2.0 * (X + hab)
    f = (X - Y) * (X - Y) + 2.0 * hbc * x * y - beta * w
    g = Y * Y + 2.0 * hca * y - gamma * w
    fx = 2.0 * (X - Y + hbc * y) - beta * wx
    fy = 2.0 * (Y - X + hbc * x)
    gx = -gamma * wx
    gy = 2.0 * (Y + hca)
    determinant = fx * gy - fy * gx
    dx = (f * gy - g * fy) / determinant
    dy = (g * fx - f * gx) / determinant
    # at a double root the step is a leap (or NaN): stay
    small = dx * dx + dy * dy < 0.01 * (x * x + y * y)
    return (x - dx if small else x), (y - dy if small else y)


@scalar
def ratio_pair(A, B, C, hab, hbc, hca, z):  # type: ignore[no-untyped-def]
    """Depth ratios x = 1 + STEP z and y = N / 2D, polished."""
    n2, n1, n0, d1, d0, _, _, _ = quadratics(A, B, C, hab, hbc, hca, STEP)
    x = 1.0 + STEP * z
    y = ((n2 * z + n1) * z + n0) / (2.0 * (d1 * z + d0))
    x, y = polish(A, B, C, hab, hbc, hca, x, y)
    return polish(A, B, C, hab, hbc, hca, x, y)


@scalar
def ratio_pairs(A, B, C, hab, hbc, hca):  # type: ignore[no-untyped-def]
    """Depth ratios (x, y) of up to four solutions, four pairs in a row; NaN or not positive where there is none."""
    n2, n1, n0, d1, d0, m2, m1, m0 = quadratics(A, B, C, hab, hbc, hca, STEP)
    q4, q3, q2, q1, q0 = quartic(n2, n1, n0, d1, d0, m2, m1, m0, hca)
    r0, r1, r2, r3 = quartic_roots(q4, q3, q2, q1, q0)
    x0, y0 = ratio_pair(A, B, C, hab, hbc, hca, r0)
    x1, y1 = ratio_pair(A, B, C, hab, hbc, hca, r1)
    x2, y2 = ratio_pair(A, B, C, hab, hbc, hca, r2)
    x3, y3 = ratio_pair(A, B, C, hab, hbc, hca, r3)
    return x0, y0, x1, y1, x2, y2, x3, y3

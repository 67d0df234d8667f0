"""The solutions of a P3P triple: roots of its quartic, polished on the distance equations they came from."""

from __future__ import annotations

from math import nan

from rootmatch.algebra.polynomial import roots_quartic
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.p3p.quartic import STEP, quadratics, quartic

NEARLY_REAL = 0.03
"""Imaginary part of z below which a pair of roots is taken as a double root that noise has split.
Not tuned: a round value."""


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
    r0, r1, r2, r3, i01, i23 = roots_quartic(q4, q3, q2, q1, q0)
    # a pair is kept once, at its real part, when it is nearly real
    r0 = r0 if i01 < NEARLY_REAL else nan
    r1 = r1 if i01 == 0.0 else nan
    r2 = r2 if i23 < NEARLY_REAL else nan
    r3 = r3 if i23 == 0.0 else nan
    x0, y0 = ratio_pair(A, B, C, hab, hbc, hca, r0)
    x1, y1 = ratio_pair(A, B, C, hab, hbc, hca, r1)
    x2, y2 = ratio_pair(A, B, C, hab, hbc, hca, r2)
    x3, y3 = ratio_pair(A, B, C, hab, hbc, hca, r3)
    return x0, y0, x1, y1, x2, y2, x3, y3


@kernel
def solve_all(t, i, j, panel):  # type: ignore[no-untyped-def]
    """`ratio_pairs` of a triple of source points with every image of the third, into rows 0 to 7 of the panel."""
    s, h = t.distance2, t.versine
    A, B, C = s[i[0], i[1]], s[i[1], i[2]], s[i[0], i[2]]
    hab, hbc, hca = h[j[0], j[1]], h[j[1]], h[j[0]]
    for k in range(panel.shape[1]):
        (
            panel[0, k], panel[1, k], panel[2, k], panel[3, k], panel[4, k], panel[5, k], panel[6, k], panel[7, k],
        ) = ratio_pairs(A, B, C, hab, hbc[k], hca[k])  # fmt: skip

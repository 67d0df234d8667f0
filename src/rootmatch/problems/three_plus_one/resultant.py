"""Kernels of the three-plus-one problem: the quartic of a triple and the resultant residuals of a 4-tuple.

Both images are turned so that the common axis is y; then u = R(θ) q is a source bearing q seen from the second camera.
A correspondence q ↔ q' obeys n · t = 0 with n = u × q' and the baseline t, three of them D(θ) = det[n₁ n₂ n₃] = 0, and
D(θ) = h(x) / (1 + x²)² with h a quartic in x = tan(θ/2) (Naroditsky et al. 2012; paper, section "3P1"). D is linear in
the last bearing q', so all but five products per target depends on the other correspondences alone.

The residuals that are measured in units of the noise are in `three_plus_one_roots`.
"""

from __future__ import annotations

import math
from typing import Any

from rootmatch.algebra.bezout import (
    smallest_singular_value_quartic,
)
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.kernels import ResidualKernels

LARGE = 1e6
"""The residual of a hyper-edge that says nothing: no information is not agreement."""
SHARED_FIRST = ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2), (2, 3, 0, 1))
"""Orders of a 4-tuple, one for each pair of its four triples: those of (0, 1, 2) and (0, 1, 3) in the new order."""


@scalar
def bearing(rays, i):  # type: ignore[no-untyped-def]
    """Column i of an array (3, n)."""
    return rays[0, i], rays[1, i], rays[2, i]


@scalar
def inner(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@scalar
def wedge(a, b):  # type: ignore[no-untyped-def]
    """Vector product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@scalar
def combined(f, a, g, b):  # type: ignore[no-untyped-def]
    """Vector f a + g b."""
    return f * a[0] + g * b[0], f * a[1] + g * b[1], f * a[2] + g * b[2]


@scalar
def turned(c, s, q):  # type: ignore[no-untyped-def]
    """R(θ) q for cosine c and sine s of θ."""
    return c * q[0] + s * q[2], q[1], c * q[2] - s * q[0]


@scalar
def slope(u):  # type: ignore[no-untyped-def]
    """Derivative in θ of a turned vector."""
    return u[2], 0.0, -u[0]


@scalar
def stem(a, k, b, l):  # type: ignore[no-untyped-def]  # noqa: E741
    """n₁ × n₂ of the correspondences a ↔ k and b ↔ l at θ = 0, 180°, 90° and −90°, and its derivative at 0."""
    a0, b0 = wedge(a, k), wedge(b, l)
    at_0 = wedge(a0, b0)
    at_180 = wedge(wedge(turned(-1.0, 0.0, a), k), wedge(turned(-1.0, 0.0, b), l))
    at_90 = wedge(wedge(turned(0.0, 1.0, a), k), wedge(turned(0.0, 1.0, b), l))
    at_270 = wedge(wedge(turned(0.0, -1.0, a), k), wedge(turned(0.0, -1.0, b), l))
    return at_0, at_180, at_90, at_270, combined(1.0, wedge(wedge(slope(a), k), b0), 1.0, wedge(a0, wedge(slope(b), l)))


@scalar
def branch(trunk, c):  # type: ignore[no-untyped-def]
    """Vectors g₄ … g₀ whose products with the third q' are the coefficients of h, for a third source bearing c.

    h(0) = D(0), the leading coefficient is D(180°), h(±1) = 4 D(±90°) and h'(0) = 2 dD/dθ(0).
    """
    at_0, at_180, at_90, at_270, slope_0 = trunk
    g0 = wedge(at_0, c)
    g4 = wedge(at_180, turned(-1.0, 0.0, c))
    plus = wedge(at_90, turned(0.0, 1.0, c))
    minus = wedge(at_270, turned(0.0, -1.0, c))
    g1 = combined(2.0, wedge(slope_0, c), 2.0, wedge(at_0, slope(c)))
    g3 = combined(1.0, combined(2.0, plus, -2.0, minus), -1.0, g1)
    g2 = combined(1.0, combined(2.0, plus, 2.0, minus), -1.0, combined(1.0, g0, 1.0, g4))
    return g4, g3, g2, g1, g0


@scalar
def coefficients(g, m):  # type: ignore[no-untyped-def]
    """Coefficients of h, highest degree first, for the third bearing m of the second image."""
    return inner(g[0], m), inner(g[1], m), inner(g[2], m), inner(g[3], m), inner(g[4], m)


@scalar
def quartic(a, k, b, l, c, m):  # type: ignore[no-untyped-def]  # noqa: E741
    """Coefficients of h, highest degree first, of the correspondences a ↔ k, b ↔ l, c ↔ m of bearings."""
    return coefficients(branch(stem(a, k, b, l), c), m)


def resultant_kernels(value: Any) -> ResidualKernels:
    """Edge and slab kernels of a residual that compares the quartics alone."""

    @kernel
    def edge(tables, kind, i, j):  # type: ignore[no-untyped-def]
        q, p = tables.source, tables.target
        worst = -1.0
        for pair in range(6):
            if kind.pairs >> pair & 1:
                a, b, c, d = SHARED_FIRST[pair]
                trunk = stem(bearing(q, i[a]), bearing(p, j[a]), bearing(q, i[b]), bearing(p, j[b]))
                h4, h3, h2, h1, h0 = coefficients(branch(trunk, bearing(q, i[c])), bearing(p, j[c]))
                f4, f3, f2, f1, f0 = coefficients(branch(trunk, bearing(q, i[d])), bearing(p, j[d]))
                worst = max(worst, value(h4, h3, h2, h1, h0, f4, f3, f2, f1, f0))
        return worst

    @kernel
    def slab(tables, kind, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
        q, p = tables.source, tables.target
        x, y, z = p[0], p[1], p[2]
        trunk = stem(bearing(q, i[0]), bearing(p, j[0]), bearing(q, i[1]), bearing(p, j[1]))
        h4, h3, h2, h1, h0 = coefficients(branch(trunk, bearing(q, i[2])), bearing(p, j[2]))
        for r in range(out.shape[0]):
            line = out[r]
            if kind.pairs == 1:
                g = branch(trunk, bearing(q, first + r))
                for n in range(line.shape[0]):
                    f4, f3, f2, f1, f0 = coefficients(g, (x[n], y[n], z[n]))
                    line[n] = value(h4, h3, h2, h1, h0, f4, f3, f2, f1, f0)
            else:
                i[3] = first + r
                for n in range(line.shape[0]):
                    line[n] = edge(tables, kind, i, (j[0], j[1], j[2], n))

    return ResidualKernels(edge, slab)


@kernel
def singular_value(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0):  # type: ignore[no-untyped-def]
    """Least singular value of the 8×8 Sylvester matrix of two quartics scaled to unit norm."""
    f = 1.0 / math.sqrt(p4 * p4 + p3 * p3 + p2 * p2 + p1 * p1 + p0 * p0)
    g = 1.0 / math.sqrt(q4 * q4 + q3 * q3 + q2 * q2 + q1 * q1 + q0 * q0)
    least = smallest_singular_value_quartic(
        f * p4, f * p3, f * p2, f * p1, f * p0, g * q4, g * q3, g * q2, g * q1, g * q0
    )
    return least if least < LARGE else LARGE

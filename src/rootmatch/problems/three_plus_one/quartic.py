"""The quartic of a triple between two views that share one direction.

Both images are rotated so that the common axis is y; then u = R(θ) q is a source bearing q in the second camera's
frame. A correspondence q ↔ q' obeys n · t = 0 with n = u × q' and the baseline t, three of them
D(θ) = det[n₁ n₂ n₃] = 0, and D(θ) = h(x) / (1 + x²)² with h a quartic in x = tan(θ/2); Naroditsky et al. (2012) and the
paper, section "3P1", have a quartic in cos θ of the same determinant. D is linear in the last bearing q', so all but
five products per target depend on the other correspondences alone.
"""

from __future__ import annotations

from rootmatch.algebra.vector import combination, cross, dot, rotated_about_y
from rootmatch.jit.decorators import scalar


@scalar
def inner(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of two vectors (x, y, z)."""
    return dot(a[0], a[1], a[2], b[0], b[1], b[2])


@scalar
def wedge(a, b):  # type: ignore[no-untyped-def]
    """Vector product of two vectors (x, y, z)."""
    return cross(a[0], a[1], a[2], b[0], b[1], b[2])


@scalar
def rotated(c, s, q):  # type: ignore[no-untyped-def]
    """R(θ) q for cosine c and sine s of θ."""
    return rotated_about_y(c, s, q[0], q[1], q[2])


@scalar
def slope(u):  # type: ignore[no-untyped-def]
    """Derivative in θ of a rotated vector."""
    return u[2], 0.0, -u[0]


@scalar
def stem(a, k, b, l):  # type: ignore[no-untyped-def]  # noqa: E741
    """n₁ × n₂ of the correspondences a ↔ k and b ↔ l at θ = 0, 180°, 90° and −90°, and its derivative at 0."""
    a0, b0 = wedge(a, k), wedge(b, l)
    at_0 = wedge(a0, b0)
    at_180 = wedge(wedge(rotated(-1.0, 0.0, a), k), wedge(rotated(-1.0, 0.0, b), l))
    at_90 = wedge(wedge(rotated(0.0, 1.0, a), k), wedge(rotated(0.0, 1.0, b), l))
    at_270 = wedge(wedge(rotated(0.0, -1.0, a), k), wedge(rotated(0.0, -1.0, b), l))
    slope_0 = combination(1.0, wedge(wedge(slope(a), k), b0), 1.0, wedge(a0, wedge(slope(b), l)))
    return at_0, at_180, at_90, at_270, slope_0


@scalar
def branch(trunk, c):  # type: ignore[no-untyped-def]
    """Vectors g₄ … g₀ whose products with the third q' are the coefficients of h, for a third source bearing c.

    h(0) = D(0), the leading coefficient is D(180°), h(±1) = 4 D(±90°) and h'(0) = 2 dD/dθ(0).
    """
    at_0, at_180, at_90, at_270, slope_0 = trunk
    g0 = wedge(at_0, c)
    g4 = wedge(at_180, rotated(-1.0, 0.0, c))
    plus = wedge(at_90, rotated(0.0, 1.0, c))
    minus = wedge(at_270, rotated(0.0, -1.0, c))
    g1 = combination(2.0, wedge(slope_0, c), 2.0, wedge(at_0, slope(c)))
    g3 = combination(1.0, combination(2.0, plus, -2.0, minus), -1.0, g1)
    g2 = combination(1.0, combination(2.0, plus, 2.0, minus), -1.0, combination(1.0, g0, 1.0, g4))
    return g4, g3, g2, g1, g0


@scalar
def coefficients(g, m):  # type: ignore[no-untyped-def]
    """Coefficients of h, highest degree first, for the third bearing m of the second image."""
    return inner(g[0], m), inner(g[1], m), inner(g[2], m), inner(g[3], m), inner(g[4], m)


@scalar
def quartic(a, k, b, l, c, m):  # type: ignore[no-untyped-def]  # noqa: E741
    """Coefficients of h, highest degree first, of the correspondences a ↔ k, b ↔ l, c ↔ m of bearings."""
    return coefficients(branch(stem(a, k, b, l), c), m)

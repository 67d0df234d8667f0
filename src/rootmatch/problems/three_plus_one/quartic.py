"""The quartic of a triple between two views that share one direction.

Both images are rotated so that the common axis is y; then u = R(θ) q is a source bearing q in the second camera's
frame. A correspondence q ↔ q' obeys n · t = 0 with n = u × q' and the baseline t, three of them
D(θ) = det[n₁ n₂ n₃] = 0, and D(θ) = h(x) / (1 + x²)² with h a quartic in x = tan(θ/2); Naroditsky et al. (2012) and the
paper, section "3P1", have a quartic in cos θ of the same determinant. D is linear in the last bearing q', so all but
five products per target depend on the other correspondences alone.
"""

from __future__ import annotations

from rootmatch.algebra.vector import combination, cross, dot, rotate_vector_about_y, slope_about_y
from rootmatch.jit.decorators import scalar


@scalar
def stem(a, k, b, l):  # type: ignore[no-untyped-def]  # noqa: E741
    """n₁ × n₂ of the correspondences a ↔ k and b ↔ l at θ = 0, 180°, 90° and −90°, and its derivative at 0."""
    a0, b0 = cross(a, k), cross(b, l)
    at_0 = cross(a0, b0)
    at_180 = cross(cross(rotate_vector_about_y(-1.0, 0.0, a), k), cross(rotate_vector_about_y(-1.0, 0.0, b), l))
    at_90 = cross(cross(rotate_vector_about_y(0.0, 1.0, a), k), cross(rotate_vector_about_y(0.0, 1.0, b), l))
    at_270 = cross(cross(rotate_vector_about_y(0.0, -1.0, a), k), cross(rotate_vector_about_y(0.0, -1.0, b), l))
    slope_0 = combination(1.0, cross(cross(slope_about_y(a), k), b0), 1.0, cross(a0, cross(slope_about_y(b), l)))
    return at_0, at_180, at_90, at_270, slope_0


@scalar
def branch(trunk, c):  # type: ignore[no-untyped-def]
    """Vectors g₄ … g₀ whose products with the third q' are the coefficients of h, for a third source bearing c.

    h(0) = D(0), the leading coefficient is D(180°), h(±1) = 4 D(±90°) and h'(0) = 2 dD/dθ(0).
    """
    at_0, at_180, at_90, at_270, slope_0 = trunk
    g0 = cross(at_0, c)
    g4 = cross(at_180, rotate_vector_about_y(-1.0, 0.0, c))
    plus = cross(at_90, rotate_vector_about_y(0.0, 1.0, c))
    minus = cross(at_270, rotate_vector_about_y(0.0, -1.0, c))
    g1 = combination(2.0, cross(slope_0, c), 2.0, cross(at_0, slope_about_y(c)))
    g3 = combination(1.0, combination(2.0, plus, -2.0, minus), -1.0, g1)
    g2 = combination(1.0, combination(2.0, plus, 2.0, minus), -1.0, combination(1.0, g0, 1.0, g4))
    return g4, g3, g2, g1, g0


@scalar
def coefficients(g, m):  # type: ignore[no-untyped-def]
    """Coefficients of h, highest degree first, for the third bearing m of the second image."""
    return dot(g[0], m), dot(g[1], m), dot(g[2], m), dot(g[3], m), dot(g[4], m)


@scalar
def quartic(a, k, b, l, c, m):  # type: ignore[no-untyped-def]  # noqa: E741
    """Coefficients of h, highest degree first, of the correspondences a ↔ k, b ↔ l, c ↔ m of bearings."""
    return coefficients(branch(stem(a, k, b, l), c), m)

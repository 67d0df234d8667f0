"""Closed forms for "do two polynomials share a root?", by the Bézout matrix.

Let p and q have degree k. Their Bézout matrix B (k×k, symmetric) holds the coefficients of
(p(x) q(y) − p(y) q(x)) / (x − y) = Σ B_ij xⁱ yʲ. Three facts carry this file:

* Σ_j c_j Σ_i B_ij xⁱ = s(x) p(x) + t(x) q(x) for any c, with s_m = −Σ_j c_j q_{j+m+1} and t_m = Σ_j c_j p_{j+m+1};
* with c the first column of the adjugate of B the left side is the constant det B = ±Res(p, q): the Bézout identity;
* at a common root x, B (1, x, …)ᵀ = 0, so every column of the adjugate is a multiple of (1, x, …, x^{k−1})ᵀ.

The row (s, t) / Res is the last row of the inverse of the Sylvester matrix M = QR, and the last row of
M⁻¹ = R⁻¹ Qᵀ is a unit vector divided by R_{2k,2k}. Hence **|R_{2k,2k}| = |Res| / ‖(s, t)‖₂** with no factorisation.

Every function takes and returns plain floats, has no branch (selects only) and allocates nothing, so that a loop around
it vectorises and the same source runs on a GPU. Coefficients come highest degree first.

Where this differs from QR in float64, measured against rational arithmetic: for random quartics and those of 3P1 it is
the closer of the two (median 3e-17, QR 6e-17; worst 5e-16, QR 1e-15). Where the roots of both crowd about one point the
Bézout matrix is nearly of lower rank and its cofactors cancel: quartics with roots within 0.05 of 1, such as P3P's in
x = b/a, are off by 1e-11 (worst 2e-8; QR 3e-16), while false hyper-edges of P3P show 1e-7 and true ones less. Taken
about that point (`unit_last_entry_quartic_about_one`) the loss becomes a gain: 1e-25, worst 1e-21.
"""

from __future__ import annotations

import math

from rootmatch.jit.decorators import scalar

NO_INFORMATION = 2.0
"""Reported for a pair with a zero polynomial, which says nothing: above √2, the most |R| of a unit pair reaches."""


@scalar
def bezout_quartic(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0):  # type: ignore[no-untyped-def]
    """Upper triangle (b00, b01, b02, b03, b11, b12, b13, b22, b23, b33) of the Bézout matrix; b_ij goes with xⁱ yʲ."""
    w30 = p3 * q0 - p0 * q3
    w40 = p4 * q0 - p0 * q4
    w41 = p4 * q1 - p1 * q4
    return (
        p1 * q0 - p0 * q1,
        p2 * q0 - p0 * q2,
        w30,
        w40,
        w30 + (p2 * q1 - p1 * q2),
        w40 + (p3 * q1 - p1 * q3),
        w41,
        w41 + (p3 * q2 - p2 * q3),
        p4 * q2 - p2 * q4,
        p4 * q3 - p3 * q4,
    )


@scalar
def first_adjugate_column(b00, b01, b02, b03, b11, b12, b13, b22, b23, b33):  # type: ignore[no-untyped-def]
    """First column (c0, c1, c2, c3) of the adjugate of a symmetric 4×4 matrix, and its determinant."""
    m01 = b02 * b13 - b12 * b03
    m02 = b02 * b23 - b22 * b03
    m03 = b02 * b33 - b23 * b03
    m12 = b12 * b23 - b22 * b13
    m13 = b12 * b33 - b23 * b13
    m23 = b22 * b33 - b23 * b23
    c0 = b11 * m23 - b12 * m13 + b13 * m12
    c1 = -(b01 * m23 - b12 * m03 + b13 * m02)
    c2 = b01 * m13 - b11 * m03 + b13 * m01
    c3 = -(b01 * m12 - b11 * m02 + b12 * m01)
    return c0, c1, c2, c3, b00 * c0 + b01 * c1 + b02 * c2 + b03 * c3


@scalar
def cofactor_norm_quartic(c0, c1, c2, c3, p4, p3, p2, p1):  # type: ignore[no-untyped-def]
    """Squared 2-norm of the polynomial Σ_m x^m Σ_j c_j p_{j+m+1}, the cofactor of the *other* polynomial (m = 0…3)."""
    t0 = c0 * p1 + c1 * p2 + c2 * p3 + c3 * p4
    t1 = c0 * p2 + c1 * p3 + c2 * p4
    t2 = c0 * p3 + c1 * p4
    t3 = c0 * p4
    return t0 * t0 + t1 * t1 + t2 * t2 + t3 * t3


@scalar
def unit_last_entry_quartic(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0):  # type: ignore[no-untyped-def]
    """|R₈₈| of the QR factorisation of the 8×8 Sylvester matrix of two quartics scaled to unit 2-norm.

    Scaling p by 1/‖p‖ scales its cofactor s by ‖p‖ relative to Res, so no coefficient is divided: it costs two squared
    norms. `NO_INFORMATION` if one of the polynomials is zero; 0 for two or more common roots.
    """
    b00, b01, b02, b03, b11, b12, b13, b22, b23, b33 = bezout_quartic(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0)
    c0, c1, c2, c3, det = first_adjugate_column(b00, b01, b02, b03, b11, b12, b13, b22, b23, b33)
    norm_p = p4 * p4 + p3 * p3 + p2 * p2 + p1 * p1 + p0 * p0
    norm_q = q4 * q4 + q3 * q3 + q2 * q2 + q1 * q1 + q0 * q0
    square = norm_q * cofactor_norm_quartic(c0, c1, c2, c3, p4, p3, p2, p1) + norm_p * cofactor_norm_quartic(
        c0, c1, c2, c3, q4, q3, q2, q1
    )
    value = abs(det) / math.sqrt(square if square > 0.0 else 1.0)
    return value if norm_p * norm_q > 0.0 else NO_INFORMATION


@scalar
def unshifted_cubic_norm(a3, a2, a1, a0):  # type: ignore[no-untyped-def]
    """Squared 2-norm of the coefficients in x of a cubic given in z = x − 1."""
    b0 = a0 - a1 + a2 - a3
    b1 = a1 - 2.0 * a2 + 3.0 * a3
    b2 = a2 - 3.0 * a3
    return b0 * b0 + b1 * b1 + b2 * b2 + a3 * a3


@scalar
def unshifted_quartic_norm(a4, a3, a2, a1, a0):  # type: ignore[no-untyped-def]
    """Squared 2-norm of the coefficients in x of a quartic given in z = x − 1."""
    b0 = a0 - a1 + a2 - a3 + a4
    b1 = a1 - 2.0 * a2 + 3.0 * a3 - 4.0 * a4
    b2 = a2 - 3.0 * a3 + 6.0 * a4
    b3 = a3 - 4.0 * a4
    return b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3 + a4 * a4


@scalar
def unit_last_entry_quartic_about_one(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0):  # type: ignore[no-untyped-def]
    """`unit_last_entry_quartic` of quartics in x whose coefficients are given in z = x − 1.

    For quartics whose roots crowd about 1 (P3P: the camera is far from its points). The resultant is the same in x and
    in z, and so is the Bézout identity; only the norms are taken in x. If the coefficients in z were computed without
    loss, this is more exact than a QR factorisation of the matrix in x: its error is below 1e-20, where the
    factorisation stops at 5e-16 and the closed form from coefficients in x at 1e-11.
    """
    b00, b01, b02, b03, b11, b12, b13, b22, b23, b33 = bezout_quartic(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0)
    c0, c1, c2, c3, det = first_adjugate_column(b00, b01, b02, b03, b11, b12, b13, b22, b23, b33)
    norm_p = unshifted_quartic_norm(p4, p3, p2, p1, p0)
    norm_q = unshifted_quartic_norm(q4, q3, q2, q1, q0)
    s = unshifted_cubic_norm(
        c0 * q4, c0 * q3 + c1 * q4, c0 * q2 + c1 * q3 + c2 * q4, c0 * q1 + c1 * q2 + c2 * q3 + c3 * q4
    )
    t = unshifted_cubic_norm(
        c0 * p4, c0 * p3 + c1 * p4, c0 * p2 + c1 * p3 + c2 * p4, c0 * p1 + c1 * p2 + c2 * p3 + c3 * p4
    )
    square = norm_p * s + norm_q * t
    value = abs(det) / math.sqrt(square if square > 0.0 else 1.0)
    return value if norm_p * norm_q > 0.0 else NO_INFORMATION


@scalar
def reverse_about_one(a4, a3, a2, a1, a0):  # type: ignore[no-untyped-def]
    """The quartic in 1/x, by powers of 1/x − 1, of a quartic in x given by powers of x − 1."""
    return (
        a0 - a1 + a2 - a3 + a4,
        4.0 * a0 - 3.0 * a1 + 2.0 * a2 - a3,
        6.0 * a0 - 3.0 * a1 + a2,
        4.0 * a0 - a1,
        a0,
    )


@scalar
def lesser_unit_last_entry_quartic_about_one(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0):  # type: ignore[no-untyped-def]
    """The lesser of both entries, see `any_degree.make_lesser_entry_kernel`, of quartics given in z = x − 1."""
    f4, f3, f2, f1, f0 = reverse_about_one(p4, p3, p2, p1, p0)
    g4, g3, g2, g1, g0 = reverse_about_one(q4, q3, q2, q1, q0)
    return min(
        unit_last_entry_quartic_about_one(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0),
        unit_last_entry_quartic_about_one(f4, f3, f2, f1, f0, g4, g3, g2, g1, g0),
    )


@scalar
def unit_last_entry_quadratic(p2, p1, p0, q2, q1, q0):  # type: ignore[no-untyped-def]
    """|R₄₄| of the 4×4 Sylvester matrix of two quadratics scaled to unit 2-norm; see `unit_last_entry_quartic`."""
    b00 = p1 * q0 - p0 * q1
    b01 = p2 * q0 - p0 * q2
    b11 = p2 * q1 - p1 * q2
    norm_p = p2 * p2 + p1 * p1 + p0 * p0
    norm_q = q2 * q2 + q1 * q1 + q0 * q0
    s0 = b11 * q1 - b01 * q2
    s1 = b11 * q2
    t0 = b11 * p1 - b01 * p2
    t1 = b11 * p2
    square = norm_p * (s0 * s0 + s1 * s1) + norm_q * (t0 * t0 + t1 * t1)
    value = abs(b00 * b11 - b01 * b01) / math.sqrt(square if square > 0.0 else 1.0)
    return value if norm_p * norm_q > 0.0 else NO_INFORMATION

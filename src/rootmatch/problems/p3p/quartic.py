"""The quartic of a P3P triple, in x = b/a, the ratio of two depths (paper, "Three-point Calibrated Absolute Pose").

Everything is computed from squared distances and from versines h = 1 − cos of the angle between two bearings: cameras
are far from their points, so cosines crowd about 1 and differences of them would lose half of the digits.
"""

from __future__ import annotations

from rootmatch.jit.decorators import scalar

STEP = 0.3
"""x = 1 + STEP z. At the paper's ranges |z| stays below 1, where the Bézout matrix is well scaled."""


@scalar
def quadratics(A, B, C, hp, hq, hr, step):  # type: ignore[no-untyped-def]
    """N, D, M of a triple as coefficients in z, x = 1 + step z: (n2, n1, n0, d1, d0, m2, m1, m0)."""
    inverse = 1.0 / A
    u = (B - C) * inverse
    v = C * inverse
    n2 = (u - 1.0) * step * step
    n1 = 2.0 * step * (u * hp - 1.0)
    n0 = 2.0 * u * hp
    d1 = (hq - 1.0) * step
    d0 = hq - hr
    m2 = -v * step * step
    m1 = -2.0 * v * hp * step
    m0 = 1.0 - 2.0 * v * hp
    return n2, n1, n0, d1, d0, m2, m1, m0


@scalar
def quartic(n2, n1, n0, d1, d0, m2, m1, m0, hr):  # type: ignore[no-untyped-def]
    """Coefficients of N² − 4 r N D + 4 D² M, highest degree first."""
    r4 = 4.0 * (1.0 - hr)
    s2 = 4.0 * d1 * d1
    s1 = 8.0 * d1 * d0
    s0 = 4.0 * d0 * d0
    q4 = n2 * n2 + s2 * m2
    q3 = 2.0 * n2 * n1 - r4 * n2 * d1 + s2 * m1 + s1 * m2
    q2 = n1 * n1 + 2.0 * n2 * n0 - r4 * (n2 * d0 + n1 * d1) + s2 * m0 + s1 * m1 + s0 * m2
    q1 = 2.0 * n1 * n0 - r4 * (n1 * d0 + n0 * d1) + s1 * m0 + s0 * m1
    q0 = n0 * n0 - r4 * n0 * d0 + s0 * m0
    return q4, q3, q2, q1, q0


@scalar
def quartic_about_one(A, B, C, hp, hq, hr):  # type: ignore[no-untyped-def]
    """The paper's quartic in x by powers of x − 1, which loses no digits where its roots crowd about 1."""
    n2, n1, n0, d1, d0, m2, m1, m0 = quadratics(A, B, C, hp, hq, hr, 1.0)
    return quartic(n2, n1, n0, d1, d0, m2, m1, m0, hr)


@scalar
def quartic_in_ratio(A, B, C, hp, hq, hr):  # type: ignore[no-untyped-def]
    """The quartic by powers of x itself, as in the paper."""
    n2, n1, n0, d1, d0, m2, m1, m0 = quadratics(A, B, C, hp, hq, hr, 1.0)
    return quartic(n2, n1 - 2.0 * n2, n0 - n1 + n2, d1, d0 - d1, m2, m1 - 2.0 * m2, m0 - m1 + m2, hr)

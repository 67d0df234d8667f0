"""Closed-form roots of quadratics and quartics, and Horner's rule; plain floats in and out, highest degree first.

Noise may push a double root off the real line. What is wanted then is where it would touch the line, so of a complex
pair the **real part** is returned, twice, and the size of the imaginary part beside it (0 for real roots): the caller
decides how far from real is too far.
"""

from __future__ import annotations

import math
from math import inf

from rootmatch.jit.decorators import scalar

THIRD = 1.0 / 3.0


@scalar
def value_quartic(a4, a3, a2, a1, a0, x):  # type: ignore[no-untyped-def]
    """The quartic at x."""
    return (((a4 * x + a3) * x + a2) * x + a1) * x + a0


@scalar
def slope_quartic(a4, a3, a2, a1, x):  # type: ignore[no-untyped-def]
    """First derivative of the quartic at x."""
    return ((4.0 * a4 * x + 3.0 * a3) * x + 2.0 * a2) * x + a1


@scalar
def curvature_quartic(a4, a3, a2, x):  # type: ignore[no-untyped-def]
    """Second derivative of the quartic at x."""
    return (12.0 * a4 * x + 6.0 * a3) * x + 2.0 * a2


@scalar
def roots_quadratic(a2, a1, a0):  # type: ignore[no-untyped-def]
    """Roots of a quadratic without cancellation.

    Returns
    -------
    r0, r1 : float
        Real roots, or twice the real part of a complex pair. With ``a2 = 0`` one of them is infinite, with
        ``a2 = a1 = 0`` both are or they mean nothing.
    imaginary : float
        Size of the imaginary part; 0 for real roots.
    """
    half = -0.5 * a1
    discriminant = half * half - a2 * a0
    root = math.sqrt(abs(discriminant))
    sum_ = half + (root if half >= 0.0 else -root)  # −½ (a1 ± …) with the sign that adds
    real = discriminant >= 0.0
    midpoint = half / a2
    r0 = sum_ / a2
    r1 = a0 / sum_ if sum_ != 0.0 else 0.0
    return (
        r0 if real else midpoint,
        r1 if real else midpoint,
        0.0 if real else root / abs(a2),
    )


@scalar
def cube_root(v):  # type: ignore[no-untyped-def]
    """Cube root of v ≥ 0 by square roots alone, which vectorise as powers do not: v^(21/64), then Halley's steps."""
    fourth = math.sqrt(math.sqrt(v))
    sixteenth = math.sqrt(math.sqrt(fourth))
    s = fourth * sixteenth * math.sqrt(math.sqrt(sixteenth))
    for _ in range(3):
        cube = s * s * s
        below = 2.0 * cube + v
        s *= (cube + 2.0 * v) / (below if below > 0.0 else 1.0)
    return s


@scalar
def cosine_of_third(w):  # type: ignore[no-untyped-def]
    """cos(acos(w) / 3) for 0 ≤ w ≤ 1: the simple root of 4v³ − 3v = w, from a parabola 3e-4 off and Newton's steps."""
    v = 0.86635526 + (0.16009645 - 0.02671697 * w) * w
    for _ in range(2):
        v2 = v * v
        v -= ((4.0 * v2 - 3.0) * v - w) / (12.0 * v2 - 3.0)
    return v


@scalar
def largest_root_cubic(a2, a1, a0):  # type: ignore[no-untyped-def]
    """Largest real root of x³ + a2 x² + a1 x + a0 (Viète's cosine for three real roots, Cardano's radical for one).

    Both are computed and one is chosen, by arithmetic and square roots alone, so that a loop over cubics vectorises.
    Half the angle goes into Viète's cosine: its cosine w, unlike that of the whole, leaves a third of it well
    conditioned where the largest root is a double one.
    """
    shift = THIRD * a2
    q = shift * shift - THIRD * a1
    r = shift * (shift * shift - 0.5 * a1) + 0.5 * a0
    q3 = q * q * q
    size = math.sqrt(max(q, 0.0))
    weight = size * q
    three = (r * r <= q3) & (weight > 0.0)
    v = cosine_of_third(math.sqrt(min(1.0, max(0.0, 0.5 - 0.5 * r / (weight if weight > 0.0 else 1.0)))))
    radical = cube_root(abs(r) + math.sqrt(max(r * r - q3, 0.0)))
    single = radical + q / (radical if radical > 0.0 else 1.0)
    x = (size * (4.0 * v * v - 2.0) if three else (-single if r > 0.0 else single)) - shift
    for _ in range(2):
        slope = (3.0 * x + 2.0 * a2) * x + a1
        value = ((x + a2) * x + a1) * x + a0
        y = x - value / (slope if slope != 0.0 else inf)
        x = y if abs(((y + a2) * y + a1) * y + a0) < abs(value) else x
    return x


@scalar
def polish(a4, a3, a2, a1, a0, x):  # type: ignore[no-untyped-def]
    """One Newton step, taken only if it brings the quartic nearer to 0 (at a double root it may not)."""
    before = value_quartic(a4, a3, a2, a1, a0, x)
    slope = slope_quartic(a4, a3, a2, a1, x)
    y = x - before / (slope if slope != 0.0 else inf)
    return y if abs(value_quartic(a4, a3, a2, a1, a0, y)) < abs(before) else x


@scalar
def polish_twice(a4, a3, a2, a1, a0, x):  # type: ignore[no-untyped-def]
    """A root of the quartic near x after two steps of `polish`."""
    return polish(a4, a3, a2, a1, a0, polish(a4, a3, a2, a1, a0, x))


@scalar
def roots_quartic(a4, a3, a2, a1, a0):  # type: ignore[no-untyped-def]
    """Roots of a quartic by Descartes' factors (y² + uy + s)(y² − uy + t) and two Newton steps.

    ``a4`` must not be negligible: where it may be, solve for 1/x, i.e. hand over the coefficients reversed.

    Returns
    -------
    r0, r1, r2, r3 : float
        Real roots, or twice the real part of a complex pair, which is r0 = r1 or r2 = r3. In no order.
    i01, i23 : float
        Size of the imaginary part of either pair; 0 for real roots.

    Notes
    -----
    Simple roots are right to rounding. Of an m-fold root, or of a cluster, floating point keeps about 16/m digits:
    that is the polynomial's condition, and a companion matrix does no better.
    """
    b = a3 / a4
    c = a2 / a4
    d = a1 / a4
    e = a0 / a4
    shift = 0.25 * b
    b2 = shift * shift
    p = c - 6.0 * b2
    q = d - 2.0 * shift * c + 8.0 * b2 * shift
    r = e - shift * d + b2 * c - 3.0 * b2 * b2
    z = largest_root_cubic(2.0 * p, p * p - 4.0 * r, -q * q)
    u = math.sqrt(max(z, 0.0))
    half = 0.5 * (p + u * u)
    # of what is nearly a quadratic in y², q and u both vanish
    even = math.sqrt(max(half * half - r, 0.0))
    split = 0.5 * q / (u if u > 0.0 else 1.0) if u * u > 0.01 * abs(p) else (even if q >= 0.0 else -even)
    s = half - split
    t = half + split
    r0, r1, i01 = roots_quadratic(1.0, u, s)
    r2, r3, i23 = roots_quadratic(1.0, -u, t)
    r0 -= shift
    r1 -= shift
    r2 -= shift
    r3 -= shift
    r0 = polish_twice(1.0, b, c, d, e, r0) if i01 == 0.0 else r0
    r1 = polish_twice(1.0, b, c, d, e, r1) if i01 == 0.0 else r1
    r2 = polish_twice(1.0, b, c, d, e, r2) if i23 == 0.0 else r2
    r3 = polish_twice(1.0, b, c, d, e, r3) if i23 == 0.0 else r3
    return r0, r1, r2, r3, i01, i23

"""Where further points are visible, by one solution of an up2p pair: the prediction and its covariance.

A pair's rotation about the vertical and its depths carry every other point into the camera, at P = λ a + q with
q = R (X − X₀). Both points keep to their bearings, λ a + R Δ = μ b, so a change of the bearings moves λ, μ and θ by the
inverse of the matrix (a, −b, R'Δ). Along an axis w orthogonal to P it moves P by
λ (w − α k − β l) · ∂a + μ (α k + β l) · ∂b with α = w · a / k · a and β = (w × q)_y / k · a, where k and l are the
first and last row of that matrix's adjugate. With the products of k and l taken once for all points, each point costs
a few scalar products. A tilt of the vertical rotates all bearings together.
"""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import cross, dot, rotated_about_y, tangent_basis
from rootmatch.jit.decorators import scalar
from rootmatch.problems.up2p.quadratic import roots, sinusoid

NEARLY = 1.01
"""A pair whose equation noise has left without a solution is still solved when γ² is below so many times α² + β². Not
tuned: a round value."""


@scalar
def rotations(dx, dy, dz, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Cosine and sine of both rotations that a difference d of two points allows for their bearings; NaN for none."""
    alpha, beta, gamma = sinusoid(dx, dy, dz, ax, ay, az, bx, by, bz)
    c1, s1, c2, s2 = roots(alpha, beta, gamma)
    solved = gamma * gamma <= NEARLY * (alpha * alpha + beta * beta)
    # the nearest approach is no rotation yet: its length is below 1
    length = 1.0 / np.sqrt(c1 * c1 + s1 * s1)
    length = length if solved else np.nan
    return c1 * length, s1 * length, c2 * length, s2 * length


@scalar
def depths(ax, ay, az, bx, by, bz, px, py, pz):  # type: ignore[no-untyped-def]
    """Depths of two points along their bearings a and b, for the rotated difference p between the points."""
    ab = dot(ax, ay, az, bx, by, bz)
    ap = dot(ax, ay, az, px, py, pz)
    bp = dot(bx, by, bz, px, py, pz)
    inverse = 1.0 / (1.0 - ab * ab)
    return (ab * bp - ap) * inverse, (bp - ab * ap) * inverse


@scalar
def solved_pair(c, s, d, a, b, va, vb):  # type: ignore[no-untyped-def]
    """A pair at one rotation: what the prediction of every other point takes from it.

    Parameters
    ----------
    c, s : float
        Cosine and sine of the rotation.
    d, a, b : (float, float, float)
        Difference of the two points, and their bearings.
    va, vb : float
        Variances of the bearings.

    Returns
    -------
    first, second : float
        Depths of both points.
    state : tuple
        For `position`, `prediction` and `tilt_covariance`.
    """
    px, py, pz = rotated_about_y(c, s, d[0], d[1], d[2])
    first, second = depths(a[0], a[1], a[2], b[0], b[1], b[2], px, py, pz)
    # first and last row of the adjugate of the matrix (a, −b, R'Δ), R'Δ = (p_z, 0, −p_x)
    k = cross(-b[0], -b[1], -b[2], pz, 0.0, -px)
    l = cross(a[0], a[1], a[2], -b[0], -b[1], -b[2])  # noqa: E741
    ka = dot(k[0], k[1], k[2], a[0], a[1], a[2])
    kk = dot(k[0], k[1], k[2], k[0], k[1], k[2])
    kl = dot(k[0], k[1], k[2], l[0], l[1], l[2])
    ll = dot(l[0], l[1], l[2], l[0], l[1], l[2])
    # k orthogonal to a; it is orthogonal to b already, and l to both
    m = (k[0] - ka * a[0], k[1] - ka * a[1], k[2] - ka * a[2])
    of_a, of_b = va * first * first, vb * second * second
    products = (of_a * (kk - ka * ka) + of_b * kk, (of_a + of_b) * kl, (of_a + of_b) * ll)
    return first, second, (c, s, a, b, first, second, 1.0 / ka, k, l, m, of_a, products)


@scalar
def position(state, ex, ey, ez):  # type: ignore[no-untyped-def]
    """Bearing of a point that differs by e from the pair's first, the inverse of its distance, and q_x and q_z."""
    c, s, a, _, first, _, _, _, _, _, _, _ = state
    qx, qy, qz = rotated_about_y(c, s, ex, ey, ez)
    x, y, z = first * a[0] + qx, first * a[1] + qy, first * a[2] + qz
    inverse = 1.0 / np.sqrt(dot(x, y, z, x, y, z))
    return x * inverse, y * inverse, z * inverse, inverse, qx, qz


@scalar
def prediction(state, ex, ey, ez):  # type: ignore[no-untyped-def]
    """Bearing of a point that differs by e from the pair's first, and its covariance along the bearing's tangent basis.

    Six numbers: x, y, z, and s11, s12, s22 in radians², by the noise of the pair's bearings alone.
    """
    _, _, a, _, _, _, by_ka, _, l, m, of_a, (qq, qr, rr) = state  # noqa: E741
    x, y, z, inverse, qx, qz = position(state, ex, ey, ez)
    (e0, e1, e2), (f0, f1, f2) = tangent_basis(x, y, z)
    ea, fa = dot(e0, e1, e2, a[0], a[1], a[2]), dot(f0, f1, f2, a[0], a[1], a[2])
    em, fm = dot(e0, e1, e2, m[0], m[1], m[2]), dot(f0, f1, f2, m[0], m[1], m[2])
    el, fl = dot(e0, e1, e2, l[0], l[1], l[2]), dot(f0, f1, f2, l[0], l[1], l[2])
    ep, fp = ea * by_ka, fa * by_ka  # α
    er, fr = (e0 * qz - e2 * qx) * by_ka, (f0 * qz - f2 * qx) * by_ka  # β
    s11 = of_a * (1.0 - ea * ea - 2.0 * (ep * em + er * el)) + qq * ep * ep + 2.0 * qr * ep * er + rr * er * er
    s22 = of_a * (1.0 - fa * fa - 2.0 * (fp * fm + fr * fl)) + qq * fp * fp + 2.0 * qr * fp * fr + rr * fr * fr
    s12 = qq * ep * fp + qr * (ep * fr + fp * er) + rr * er * fr
    s12 -= of_a * (ea * fa + ep * fm + fp * em + er * fl + fr * el)
    scale = inverse * inverse
    return x, y, z, s11 * scale, s12 * scale, s22 * scale


@scalar
def tilt_response(state, w, qx, qz, inverse, x, y, z):  # type: ignore[no-untyped-def]
    """How a point's predicted component along w responds to a tilt of the vertical about x and about z.

    w · ∂P/∂a = λ (w − g) and w · ∂P/∂b = μ g, and a tilt ω moves a by ω × a and b by ω × b. It rotates the detection of
    the point as well.
    """
    _, _, a, b, first, second, by_ka, k, l, _, _, _ = state  # noqa: E741
    along = dot(w[0], w[1], w[2], a[0], a[1], a[2]) * by_ka
    about = (w[0] * qz - w[2] * qx) * by_ka
    gx, gy, gz = along * k[0] + about * l[0], along * k[1] + about * l[1], along * k[2] + about * l[2]
    first, second = first * inverse, second * inverse
    ux, _, uz = cross(a[0], a[1], a[2], first * (w[0] - gx), first * (w[1] - gy), first * (w[2] - gz))
    vx, _, vz = cross(b[0], b[1], b[2], second * gx, second * gy, second * gz)
    rx, _, rz = cross(x, y, z, w[0], w[1], w[2])
    return ux + vx - rx, uz + vz - rz


@scalar
def tilt_covariance(state, ex, ey, ez, tilt):  # type: ignore[no-untyped-def]
    """What a tilt of the vertical with variance ``tilt`` adds to s11, s12, s22 of `prediction`."""
    x, y, z, inverse, qx, qz = position(state, ex, ey, ez)
    e, f = tangent_basis(x, y, z)
    e_x, e_z = tilt_response(state, e, qx, qz, inverse, x, y, z)
    f_x, f_z = tilt_response(state, f, qx, qz, inverse, x, y, z)
    return tilt * (e_x * e_x + e_z * e_z), tilt * (e_x * f_x + e_z * f_z), tilt * (f_x * f_x + f_z * f_z)

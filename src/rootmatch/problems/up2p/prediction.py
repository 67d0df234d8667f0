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

from rootmatch.algebra.vector import (
    add_vectors,
    combination,
    cross,
    difference,
    dot,
    rotate_vector_about_y,
    scale_vector,
    slope_about_y,
    tangent_basis,
)
from rootmatch.jit.decorators import scalar
from rootmatch.problems.up2p.quadratic import roots, sinusoid

NEARLY = 1.01
"""A pair whose equation noise has left without a solution is still solved when γ² is below so many times α² + β². Not
tuned: a round value."""


@scalar
def rotations(d, a, b):  # type: ignore[no-untyped-def]
    """Cosine and sine of both rotations that a difference d of two points allows for their bearings; NaN for none."""
    alpha, beta, gamma = sinusoid(d, a, b)
    c1, s1, c2, s2 = roots(alpha, beta, gamma)
    solved = gamma * gamma <= NEARLY * (alpha * alpha + beta * beta)
    # the nearest approach is no rotation yet: its length is below 1
    length = 1.0 / np.sqrt(c1 * c1 + s1 * s1)
    length = length if solved else np.nan
    return c1 * length, s1 * length, c2 * length, s2 * length


@scalar
def depths(a, b, p):  # type: ignore[no-untyped-def]
    """Depths of two points along their bearings a and b, for the rotated difference p between the points."""
    ab, ap, bp = dot(a, b), dot(a, p), dot(b, p)
    inverse = 1.0 / (1.0 - ab * ab)
    return (ab * bp - ap) * inverse, (bp - ab * ap) * inverse


@scalar
def solve_pair(c, s, d, a, b, va, vb):  # type: ignore[no-untyped-def]
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
    p = rotate_vector_about_y(c, s, d)
    first, second = depths(a, b, p)
    # first and last row of the adjugate of the matrix (a, −b, R'Δ)
    k, l = cross(slope_about_y(p), b), cross(b, a)  # noqa: E741
    ka, kk, kl, ll = dot(k, a), dot(k, k), dot(k, l), dot(l, l)
    # k orthogonal to a; it is orthogonal to b already, and l to both
    m = combination(1.0, k, -ka, a)
    of_a, of_b = va * first * first, vb * second * second
    products = (of_a * (kk - ka * ka) + of_b * kk, (of_a + of_b) * kl, (of_a + of_b) * ll)
    return first, second, (c, s, a, b, first, second, 1.0 / ka, k, l, m, of_a, products)


@scalar
def position(state, e):  # type: ignore[no-untyped-def]
    """Bearing of a point that differs by e from the pair's first, the inverse of its distance, and e rotated."""
    c, s, a, _, first, _, _, _, _, _, _, _ = state
    q = rotate_vector_about_y(c, s, e)
    place = add_vectors(scale_vector(first, a), q)
    inverse = 1.0 / np.sqrt(dot(place, place))
    return scale_vector(inverse, place), inverse, q


@scalar
def prediction(state, e):  # type: ignore[no-untyped-def]
    """Bearing of a point that differs by e from the pair's first, and its covariance along the bearing's tangent basis.

    A vector, and s11, s12, s22 in radians², by the noise of the pair's bearings alone.
    """
    _, _, a, _, _, _, by_ka, _, l, m, of_a, (qq, qr, rr) = state  # noqa: E741
    bearing, inverse, q = position(state, e)
    one, two = tangent_basis(bearing[0], bearing[1], bearing[2])
    ea, em, el = dot(one, a), dot(one, m), dot(one, l)
    fa, fm, fl = dot(two, a), dot(two, m), dot(two, l)
    ep, fp = ea * by_ka, fa * by_ka  # α
    er, fr = dot(one, slope_about_y(q)) * by_ka, dot(two, slope_about_y(q)) * by_ka  # β
    s11 = of_a * (1.0 - ea * ea - 2.0 * (ep * em + er * el)) + qq * ep * ep + 2.0 * qr * ep * er + rr * er * er
    s22 = of_a * (1.0 - fa * fa - 2.0 * (fp * fm + fr * fl)) + qq * fp * fp + 2.0 * qr * fp * fr + rr * fr * fr
    s12 = qq * ep * fp + qr * (ep * fr + fp * er) + rr * er * fr
    s12 -= of_a * (ea * fa + ep * fm + fp * em + er * fl + fr * el)
    scale = inverse * inverse
    return bearing, (s11 * scale, s12 * scale, s22 * scale)


@scalar
def tilt_response(state, w, q, inverse, bearing):  # type: ignore[no-untyped-def]
    """How a point's predicted component along w responds to a tilt of the vertical about x and about z.

    w · ∂P/∂a = λ (w − g) and w · ∂P/∂b = μ g, and a tilt ω moves a by ω × a and b by ω × b. It rotates the detection of
    the point as well.
    """
    _, _, a, b, first, second, by_ka, k, l, _, _, _ = state  # noqa: E741
    g = combination(dot(w, a) * by_ka, k, dot(w, slope_about_y(q)) * by_ka, l)
    u, v = cross(a, scale_vector(first * inverse, difference(w, g))), cross(b, scale_vector(second * inverse, g))
    moved = difference(add_vectors(u, v), cross(bearing, w))
    return moved[0], moved[2]


@scalar
def tilt_covariance(state, e, tilt):  # type: ignore[no-untyped-def]
    """What a tilt of the vertical with variance ``tilt`` adds to s11, s12, s22 of `prediction`."""
    bearing, inverse, q = position(state, e)
    one, two = tangent_basis(bearing[0], bearing[1], bearing[2])
    e_x, e_z = tilt_response(state, one, q, inverse, bearing)
    f_x, f_z = tilt_response(state, two, q, inverse, bearing)
    return tilt * (e_x * e_x + e_z * e_z), tilt * (e_x * f_x + e_z * f_z), tilt * (f_x * f_x + f_z * f_z)

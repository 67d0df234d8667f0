"""The residual of a 3P1 hyper-edge in units of the noise, by the roots of its first three correspondences.

At every root θ of D(θ) = det[n₁ n₂ n₃] (see `three_plus_one`) the baseline t follows, and they predict where the fourth
correspondence must lie:

    z² = e² / (σ₄² + J P Jᵀ),   e = n₄ · t,   J = ∂e/∂(θ, t),   P = J₃⁻¹ diag(σ₁², σ₂², σ₃²) J₃⁻ᵀ,

with σᵢ the noise of eᵢ itself (Sampson's) and J₃ the Jacobian of e₁, e₂, e₃, whose determinant is dD/dθ. To first order
this *is* the resultant over its deviation, whichever triples are compared. But roots by closed form stay where they are
when they crowd, which they do for a short baseline and where a Bézout matrix loses them; the points must lie in front
of both cameras, which a resultant cannot see and which most false hyper-edges that pass otherwise fail; and all but
some thirty operations depend on the first three correspondences and the fourth source point alone.
"""

from __future__ import annotations

import math
from math import nan

from rootmatch.algebra.polynomial import curvature_quartic, roots_quartic, value_quartic
from rootmatch.algebra.vector import column, combination, cross, dot, rotate_vector_about_y, slope_about_y
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.limits import UNINFORMATIVE, VAGUE2
from rootmatch.problems.pairs import edge_kernel_of_pairs, root_kernel, slab_kernel_of_edges
from rootmatch.problems.three_plus_one.quartic import quartic

ROOT_GATE = 6.0
"""A complex pair counts, by its real part, while D there is below so many of its standard deviations. Not tuned."""
SIDE_GATE2 = 4.0
"""A point may lie behind a camera by so many variances of the parallax (2σ): it may be at infinity. Not tuned."""
BLUR = 0.03
"""Near a double root σ_θ = σ_D / |D'| grows without bound, yet the two roots enclose what may be: D'² is raised by
BLUR · |D''| σ_D. Full strength would be ½; 0.03 keeps the distribution of true residuals, measured by
tests/test_residual_distributions.py, and stops false agreement."""
FULL_BLUR = 0.5
"""Factor in the place of BLUR where the spread of the roots only widens a tolerance: its full strength."""
SAME = 1e-4
"""Normals whose vector product is below the root of this times their noise, squared, span no plane: t is unknown. Not
tuned."""


@kernel
def roots(h):  # type: ignore[no-untyped-def]
    """Real parts of the roots of h, or of h reversed (1/x) where that is better scaled.

    Returns
    -------
    y : tuple of 4 floats
        NaN for the second of a complex pair, which would repeat the first.
    h : tuple of 5 floats
        The coefficients that they belong to.
    sign : float
        −1 for 1/x = cot(θ/2), whose cosine is the opposite; else 1.
    """
    h4, h3, h2, h1, h0 = h
    sign = 1.0
    if abs(h0) > abs(h4):
        h4, h3, h1, h0 = h0, h1, h3, h4
        sign = -1.0
    r0, r1, r2, r3, i01, i23 = roots_quartic(h4, h3, h2, h1, h0)
    return (r0, nan if i01 > 0.0 else r1, r2, nan if i23 > 0.0 else r3), (h4, h3, h2, h1, h0), sign


@scalar
def longest_cross(a, b, c):  # type: ignore[no-untyped-def]
    """Unit vector across three vectors near one plane, the longest of their products, and its square before scaling."""
    p = cross(a, b)
    q = cross(b, c)
    r = cross(c, a)
    best, pp, qq, rr = p, dot(p, p), dot(q, q), dot(r, r)
    if qq > pp:
        best, pp = q, qq
    if rr > pp:
        best, pp = r, rr
    scale = 1.0 / math.sqrt(pp)
    return (scale * best[0], scale * best[1], scale * best[2]), pp


@scalar
def own_variance(t, u, p, du, dp):  # type: ignore[no-untyped-def]
    """Variance of e = p · (t × u) from the deviations of p and of u, where e is near 0."""
    k = dot(t, u)
    a = dot(t, p)
    return dp * dp * (1.0 - k * k) + du * du * (1.0 - a * a)


@scalar
def tilt(t, u, p):  # type: ignore[no-untyped-def]
    """∂e/∂ω, x and z components, for a small rotation ω of the second view: p × (t × u)."""
    a = dot(t, p)
    m = dot(u, p)
    return t[0] * m - u[0] * a, t[2] * m - u[2] * a


@scalar
def sides(t, u, p):  # type: ignore[no-untyped-def]
    """Two numbers, linear in p, that say where two bearings in one plane with t meet.

    λ u + t = λ' p has λ' > 0 where p · (t − (t·u) u) > 0, and then λ > 0 where p · (u − (t·u) t) > 0. For −t the first
    changes sign. The first is the parallax, 0 for a point at infinity; the second is 0 where p looks along t.
    """
    k = dot(t, u)
    return dot(p, t) - k * dot(p, u), dot(p, u) - k * dot(p, t)


@scalar
def signs_in_front(t, u, p, du, dp, turn_variance, baseline_variance):  # type: ignore[no-untyped-def]
    """Whether a point may lie in front of both cameras for t, and for −t, by its deviations and those of θ and t."""
    parallax, ahead = sides(t, u, p)
    k = dot(t, u)
    own = du * du + dp * dp
    rest = 1.0 - k * k
    by_turn = dot(t, slope_about_y(u))
    unsure = parallax * parallax < SIDE_GATE2 * (rest * own + by_turn * by_turn * turn_variance)
    possible = (ahead > 0.0) | (ahead * ahead < SIDE_GATE2 * rest * (own + baseline_variance))
    return possible & ((parallax > 0.0) | unsure), possible & ((parallax < 0.0) | unsure)


@scalar
def root_state(y, sign, h, a, k, b, l, c, m, da, dk, db, dl, dc, dm):  # type: ignore[no-untyped-def]  # noqa: E741
    """What a fourth correspondence meets at one root of the first three, a ↔ k, b ↔ l, c ↔ m with their deviations.

    Returns whether the root counts with the three points in front for t, and for −t (it counts if it is real within
    noise), t, and what `prediction` needs: cosine and sine, det J₃, its square raised by BLUR, variances of θ and t,
    and of each correspondence the row (s, w) of the adjugate of J₃ (in θ, and across t), variance and tilt.
    """
    scale = 1.0 + y * y
    cosine = sign * (1.0 - y * y) / scale
    sine = 2.0 * y / scale
    u1, u2, u3 = (
        rotate_vector_about_y(cosine, sine, a),
        rotate_vector_about_y(cosine, sine, b),
        rotate_vector_about_y(cosine, sine, c),
    )
    n1, n2, n3 = cross(u1, k), cross(u2, l), cross(u3, m)
    t, plane = longest_cross(n1, n2, n3)
    j1 = dot(cross(slope_about_y(u1), k), t)
    j2 = dot(cross(slope_about_y(u2), l), t)
    j3 = dot(cross(slope_about_y(u3), m), t)
    s1, s2, s3 = dot(cross(n2, n3), t), dot(cross(n3, n1), t), dot(cross(n1, n2), t)
    w1, w2, w3 = combination(j3, n2, -j2, n3), combination(j1, n3, -j3, n1), combination(j2, n1, -j1, n2)
    det = s1 * j1 + s2 * j2 + s3 * j3
    v1 = own_variance(t, u1, k, da, dk)
    v2 = own_variance(t, u2, l, db, dl)
    v3 = own_variance(t, u3, m, dc, dm)
    variance = s1 * s1 * v1 + s2 * s2 * v2 + s3 * s3 * v3
    # d²D/dθ² is h''/4 up to terms in h and h', which are small where it matters
    blur = 0.25 * abs(curvature_quartic(h[0], h[1], h[2], y)) * math.sqrt(variance)
    square = det * det + BLUR * blur
    wide = 1.0 / (det * det + FULL_BLUR * blur)
    turn_variance = variance * wide
    baseline_variance = (dot(w1, w1) * v1 + dot(w2, w2) * v2 + dot(w3, w3) * v3) * wide
    # D = h / (1 + x²)²
    value = value_quartic(h[0], h[1], h[2], h[3], h[4], y)
    noise = da * da + dk * dk
    counts = (
        (value * value < ROOT_GATE * ROOT_GATE * variance * scale * scale * scale * scale)
        & (square > 0.0)
        & (plane > SAME * noise * noise)
    )
    front1, back1 = signs_in_front(t, u1, k, da, dk, turn_variance, baseline_variance)
    front2, back2 = signs_in_front(t, u2, l, db, dl, turn_variance, baseline_variance)
    front3, back3 = signs_in_front(t, u3, m, dc, dm, turn_variance, baseline_variance)
    one = (s1, w1, v1, tilt(t, u1, k))
    two = (s2, w2, v2, tilt(t, u2, l))
    three = (s3, w3, v3, tilt(t, u3, m))
    state = (cosine, sine, det, square, turn_variance, baseline_variance, one, two, three)
    return counts & front1 & front2 & front3, counts & back1 & back2 & back3, t, state


@kernel
def judge(y, passes, sign, h, a, k, b, l, c, m, da, dk, db, dl, dc, dm):  # type: ignore[no-untyped-def]  # noqa: E741
    """Whether each of the roots counts at all: `root_state` in a loop that vectorises, being a function of its own."""
    for index in range(y.shape[0]):
        front, back, _, _ = root_state(y[index], sign, h, a, k, b, l, c, m, da, dk, db, dl, dc, dm)
        passes[index] = 1.0 if front | back else 0.0


@scalar
def response(row, t, u, turn, k):  # type: ignore[no-untyped-def]
    """F with p · F = J · (row of the adjugate of J₃): how e₄ responds to one of e₁, e₂, e₃, times det J₃."""
    s, w, _, _ = row
    return combination(1.0, combination(s, turn, dot(w, u), t), -k, w)


@scalar
def add_outer_product(form, f, v):  # type: ignore[no-untyped-def]
    """Symmetric 3×3 form (xx, yy, zz, xy, xz, yz) plus f v vᵀ."""
    x, y, z = f * v[0], f * v[1], f * v[2]
    xx, yy, zz, xy, xz, yz = form
    return xx + x * v[0], yy + y * v[1], zz + z * v[2], xy + x * v[1], xz + x * v[2], yz + y * v[2]


@scalar
def prediction(t, state, q, deviation, tilt_variance):  # type: ignore[no-untyped-def]
    """Prediction of a fourth source bearing q in the second view, with its variance.

    Returns the normal E of its epipolar plane (e = p · E), the form V with variance pᵀ V p + rest · (variance of p),
    the vectors and variances of `sides`, and that rest, which is theirs too.
    """
    cosine, sine, det, square, turn_variance, baseline_variance, one, two, three = state
    u = rotate_vector_about_y(cosine, sine, q)
    turn = cross(t, slope_about_y(u))
    k = dot(t, u)
    f1 = response(one, t, u, turn, k)
    f2 = response(two, t, u, turn, k)
    f3 = response(three, t, u, turn, k)
    inverse = 1.0 / square
    v = deviation * deviation
    form = add_outer_product((v, v, v, 0.0, 0.0, 0.0), -v, t)
    form = add_outer_product(form, inverse * one[2], f1)
    form = add_outer_product(form, inverse * two[2], f2)
    form = add_outer_product(form, inverse * three[2], f3)
    # a tilt of the axis moves all four together: det · ∂e₄/∂ω less what the first three pass on
    tilt1, tilt2, tilt3 = one[3], two[3], three[3]
    for axis in range(2):
        own = combination(det * t[2 * axis], u, -det * u[2 * axis], t)
        passed = combination(1.0, combination(tilt1[axis], f1, tilt2[axis], f2), tilt3[axis], f3)
        form = add_outer_product(form, inverse * tilt_variance, combination(1.0, own, -1.0, passed))
    rest = 1.0 - k * k
    by_turn = dot(t, slope_about_y(u))
    parallax_variance = rest * v + by_turn * by_turn * turn_variance
    ahead_variance = rest * (v + baseline_variance)
    across, ahead = combination(1.0, t, -k, u), combination(1.0, u, -k, t)
    return cross(t, u), form, across, parallax_variance, ahead, ahead_variance, rest


@scalar
def squared_residual(front, back, line, p, dp):  # type: ignore[no-untyped-def]
    """z² of a fourth target bearing p; UNINFORMATIVE² where the point is behind a camera or the prediction is vague."""
    normal, form, across, parallax_variance, forward, ahead_variance, rest = line
    xx, yy, zz, xy, xz, yz = form
    x, y, z = p
    own = rest * dp * dp
    e = dot(normal, p)
    variance = x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + zz * z * z + own
    parallax = dot(across, p)
    ahead = dot(forward, p)
    unsure = parallax * parallax < SIDE_GATE2 * (parallax_variance + own)
    right = (front and parallax > 0.0) or (back and parallax < 0.0) or unsure
    visible = right and (ahead > 0.0 or ahead * ahead < SIDE_GATE2 * (ahead_variance + own))
    z2 = e * e / variance
    return z2 if visible and variance < VAGUE2 and z2 < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@kernel
def residual(tables, i, j, order):  # type: ignore[no-untyped-def]
    """Square of the residual of one hyper-edge in the given order: its last point against the roots of its first."""
    q, p = tables.source, tables.target
    dq, dp = tables.source_deviation, tables.target_deviation
    i0, i1, i2, i3 = i[order[0]], i[order[1]], i[order[2]], i[order[3]]
    j0, j1, j2, j3 = j[order[0]], j[order[1]], j[order[2]], j[order[3]]
    a, b, c = column(q, i0), column(q, i1), column(q, i2)
    k, l, m = column(p, j0), column(p, j1), column(p, j2)  # noqa: E741
    angles, h, sign = roots(quartic(a, k, b, l, c, m))
    da, db, dc = dq[i0], dq[i1], dq[i2]
    dk, dl, dm = dp[j0], dp[j1], dp[j2]
    minimum = UNINFORMATIVE * UNINFORMATIVE
    for index in range(4):
        front, back, t, state = root_state(angles[index], sign, h, a, k, b, l, c, m, da, dk, db, dl, dc, dm)
        if front or back:
            line = prediction(t, state, column(q, i3), dq[i3], tables.tilt_variance[0])
            minimum = min(minimum, squared_residual(front, back, line, column(p, j3), dp[j3]))
    return minimum


edge = root_kernel(edge_kernel_of_pairs(residual, 3))
several = slab_kernel_of_edges(edge)


@kernel
def slab(tables, kind, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
    """Slab kernel: the roots once, the epipolar line once a source point, thirty operations a target."""
    rows, targets = out.shape
    if kind.pairs != 1:
        several(tables, kind, i, j, first, out)
        return
    q, p = tables.source, tables.target
    dq, dp = tables.source_deviation, tables.target_deviation
    a, b, c = column(q, i[0]), column(q, i[1]), column(q, i[2])
    k, l, m = column(p, j[0]), column(p, j[1]), column(p, j[2])  # noqa: E741
    angles, h, sign = roots(quartic(a, k, b, l, c, m))
    da, db, dc = dq[i[0]], dq[i[1]], dq[i[2]]
    dk, dl, dm = dp[j[0]], dp[j[1]], dp[j[2]]
    x, y, z = p[0], p[1], p[2]
    # Most roots fail: all are judged in one vectorised loop, and only those that pass are evaluated again. Twice over,
    # because such loops start at eight.
    angle, passes = scratch[0, :8], scratch[1, :8]
    angle[0], angle[1], angle[2], angle[3] = angles
    angle[4], angle[5], angle[6], angle[7] = angles
    judge(angle, passes, sign, h, a, k, b, l, c, m, da, dk, db, dl, dc, dm)
    found = False
    for index in range(4):
        if passes[index] == 0.0:
            continue
        front, back, t, state = root_state(angle[index], sign, h, a, k, b, l, c, m, da, dk, db, dl, dc, dm)
        for r in range(rows):
            to = out[r]
            line = prediction(t, state, column(q, first + r), dq[first + r], tables.tilt_variance[0])
            for n in range(targets):
                z2 = squared_residual(front, back, line, (x[n], y[n], z[n]), dp[n])
                to[n] = min(to[n], z2) if found else z2
        found = True
    for r in range(rows):
        to = out[r]
        for n in range(targets):
            to[n] = math.sqrt(to[n]) if found else UNINFORMATIVE

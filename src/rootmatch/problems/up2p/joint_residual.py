"""Both constraints of an up2p hyper-edge at once, and what its other residuals share with them.

A hyper-edge of three correspondences has three equations like `quadratic` and one unknown: two constraints. They are
evaluated at both roots of the first pair, whose sines and cosines, and all that depends on them, are the same for every
third image point: a few products remain for each.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.algebra.vector import (
    add_vectors,
    column,
    column4,
    cross,
    difference,
    dot,
    rotate_vector_about_y,
    scale_vector,
    slope_about_y,
    symmetric_adjugate,
    symmetric_times,
)
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.pairs import edge_kernel_of_pairs, root_kernel, slab_kernel_of_rows
from rootmatch.problems.up2p.prediction import depths
from rootmatch.problems.up2p.quadratic import is_facing, roots, sinusoid


@scalar
def root_state(c, s, facing, points, normal, a, b, va, vb, tilt):  # type: ignore[no-untyped-def]
    """Everything at one root of the first pair that does not depend on the third bearing."""
    # rotated differences p = RΔ01, q = RΔ02, r = RΔ12
    p = rotate_vector_about_y(c, s, difference(points[1], points[0]))
    q = rotate_vector_about_y(c, s, difference(points[2], points[0]))
    r = difference(q, p)
    u = cross(a, b)
    # f01 = u · p, f02 = u2 · (q × a), f12 = u2 · (r × b), and their slopes in θ
    k, l = cross(q, a), cross(r, b)  # noqa: E741
    m, n = cross(slope_about_y(q), a), cross(slope_about_y(r), b)
    # partials of f01 in the bearings a and b, and products of these with u2 × q and u2 × r
    g, h = cross(b, p), cross(p, a)
    # a tilt rotates all bearings together: ∂f/∂ω = n × d, of which x and z count
    turned = cross(u, p)
    tx, tz = turned[0], turned[2]
    w11 = va * dot(g, g) + vb * dot(h, h) + tilt * (tx * tx + tz * tz)
    depth0, depth1 = depths(a, b, p)
    place = add_vectors(scale_vector(depth0, a), q)
    in_view = is_facing(c, s, normal, scale_vector(1.0 / np.sqrt(dot(place, place)), place))
    front = facing and (depth0 > 0.0) and (depth1 > 0.0) and in_view
    products = (w11, -dot(k, l), dot(k, k), dot(l, l), tx, tz, dot(a, q), dot(b, r))
    return dot(u, p), dot(u, slope_about_y(p)), k, l, m, n, cross(q, g), cross(r, h), products, q, r, front, place


@scalar
def system(root, a, b, va, vb, tilt, ray, v):  # type: ignore[no-untyped-def]
    """Values, slopes and covariance of f01, f02, f12 for the third bearing, and whether it looks at the point."""
    f1, g1, k, l, m, n, qg, rh, products, q, r, front, place = root  # noqa: E741
    w11, w23, w22, w33, tx, tz, aq, br = products
    s, u = cross(ray, q), cross(ray, r)
    # tilt: (a × u2) × q = u2 (a·q) − a (u2·q), x and z components
    xq, xr = dot(ray, q), dot(ray, r)
    ex, ez = ray[0] * aq - a[0] * xq, ray[2] * aq - a[2] * xq
    hx, hz = ray[0] * br - b[0] * xr, ray[2] * br - b[2] * xr
    c12 = va * dot(ray, qg) + tilt * (tx * ex + tz * ez)
    c13 = vb * dot(ray, rh) + tilt * (tx * hx + tz * hz)
    c22 = va * dot(s, s) + v * w22 + tilt * (ex * ex + ez * ez)
    c33 = vb * dot(u, u) + v * w33 + tilt * (hx * hx + hz * hz)
    c23 = -v * w23 + tilt * (ex * hx + ez * hz)
    values, slopes = (f1, dot(ray, k), dot(ray, l)), (g1, dot(ray, m), dot(ray, n))
    return values, slopes, (w11, c12, c13, c22, c23, c33), front and (dot(ray, place) > 0.0)


@scalar
def joint_chi2_at_root(root, a, b, va, vb, tilt, ray, v):  # type: ignore[no-untyped-def]
    """χ² of both constraints at one root: Fᵀ W⁻¹ F less what a change of θ explains."""
    values, slopes, covariance, visible = system(root, a, b, va, vb, tilt, ray, v)
    adjugate, determinant = symmetric_adjugate(covariance)
    scaled_slopes = symmetric_times(adjugate, slopes)
    along = dot(values, scaled_slopes)
    total = dot(values, symmetric_times(adjugate, values))
    chi2 = (total - along * along / dot(slopes, scaled_slopes)) / determinant
    return chi2 if visible and chi2 >= 0.0 and chi2 < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@scalar
def normalised_squared_at_root(root, a, b, va, vb, tilt, ray, v):  # type: ignore[no-untyped-def]
    """Square of the resultant of f01 and f02 over its variance, at one root."""
    (f1, f2, _), (g1, g2, _), (c11, c12, _, c22, _, _), _ = system(root, a, b, va, vb, tilt, ray, v)
    value = g1 * f2 - g2 * f1
    variance = g1 * g1 * c22 - 2.0 * g1 * g2 * c12 + g2 * g2 * c11
    ratio = value * value / variance
    return ratio if ratio < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@scalar
def root_states(t, i0, i1, i2, j0, j1):  # type: ignore[no-untyped-def]
    """`root_state` at the two roots of the pair (i0, j0), (i1, j1), with what `system` takes beside it."""
    u, m = t.rays, t.normals
    points = column(t.points, i0), column(t.points, i1), column(t.points, i2)
    a, b = column(u, j0), column(u, j1)
    m0, m1, m2 = column4(m, i0), column4(m, i1), column4(m, i2)
    va, vb, tilt = t.variance[j0], t.variance[j1], t.tilt_variance[0]
    alpha, beta, gamma = sinusoid(difference(points[1], points[0]), a, b)
    c1, s1, c2, s2 = roots(alpha, beta, gamma)
    one = root_state(c1, s1, is_facing(c1, s1, m0, a) and is_facing(c1, s1, m1, b), points, m2, a, b, va, vb, tilt)
    two = root_state(c2, s2, is_facing(c2, s2, m0, a) and is_facing(c2, s2, m1, b), points, m2, a, b, va, vb, tilt)
    return one, two, a, b, va, vb, tilt


def make_pair_kernel(value: Any) -> Any:
    """Kernel of one pair ``(t, i, j, order)``: the lesser square at the two roots of the pair's first equation."""

    @scalar
    def squared(t, i, j, order):  # type: ignore[no-untyped-def]
        first, second, third = order
        one, two, a, b, va, vb, tilt = root_states(t, i[first], i[second], i[third], j[first], j[second])
        ray, v = column(t.rays, j[third]), t.variance[j[third]]
        return min(value(one, a, b, va, vb, tilt, ray, v), value(two, a, b, va, vb, tilt, ray, v))

    return squared


squared = edge_kernel_of_pairs(make_pair_kernel(joint_chi2_at_root), 2)
edge = root_kernel(squared)


@kernel
def row(t, i, j, last, line):  # type: ignore[no-untyped-def]
    """Squares of the residuals of the first pair with a source point and every target point."""
    one, two, a, b, va, vb, tilt = root_states(t, i[0], i[1], last, j[0], j[1])
    x, y, z, v = t.rays[0], t.rays[1], t.rays[2], t.variance
    for k in range(line.shape[0]):
        first = joint_chi2_at_root(one, a, b, va, vb, tilt, (x[k], y[k], z[k]), v[k])
        second = joint_chi2_at_root(two, a, b, va, vb, tilt, (x[k], y[k], z[k]), v[k])
        line[k] = min(first, second)


slab = slab_kernel_of_rows(row, squared)

"""One resultant of an upright hyper-edge in units of the noise, for every third image at once.

At a root θ of the first pair the resultant is linear in the third bearing x and its variance a quadratic form:
r² = (L·x)² / (xᵀ Q x + c v), v the variance of x. L, Q and c depend on the pair and the third source point alone: ten
numbers, after which a root costs sixteen operations an image.
"""

from __future__ import annotations

from rootmatch.algebra.vector import (
    add_vectors,
    column,
    combination,
    cross,
    difference,
    dot,
    rotate_vector_about_y,
    scale_vector,
    slope_about_y,
)
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.pairs import edge_kernel_of_pairs, root_kernel, slab_kernel_of_rows
from rootmatch.problems.up2p.joint_residual import make_pair_kernel, normalised_squared_at_root
from rootmatch.problems.up2p.quadratic import roots, sinusoid

squared = edge_kernel_of_pairs(make_pair_kernel(normalised_squared_at_root), 2)
edge = root_kernel(squared)


@scalar
def quadratic_forms(c, s, d, e, a, b, va, vb, tilt):  # type: ignore[no-untyped-def]
    """L, Q (xx, xy, xz, yy, yz, zz; off the diagonal twice) and c, for the differences d = 1 − 0 and e = 2 − 0.

    As `joint_residual.system`: with p and q these differences rotated, f₀₁ = (a × b) · p and f₀₂ = x · (q × a).
    """
    p, q = rotate_vector_about_y(c, s, d), rotate_vector_about_y(c, s, e)
    u = cross(a, b)
    f, g = dot(u, p), dot(u, slope_about_y(p))
    k, m = cross(q, a), cross(slope_about_y(q), a)
    # partials of f₀₁ in a, in b and in a tilt
    r, h, turned = cross(b, p), cross(p, a), cross(u, p)
    tx, tz = turned[0], turned[2]
    w11 = va * dot(r, r) + vb * dot(h, h) + tilt * (tx * tx + tz * tz)
    # those of f₀₂ are linear in x: q × x in a, and in a tilt x·X and x·Z
    aq = dot(a, q)
    X = (aq - a[0] * q[0], -a[0] * q[1], -a[0] * q[2])
    Z = (-a[2] * q[0], -a[2] * q[1], aq - a[2] * q[2])
    along = add_vectors(scale_vector(va, cross(q, r)), scale_vector(tilt, combination(tx, X, tz, Z)))
    # g² var f₀₂ − 2 g m·x cov(f₀₁, f₀₂) + (m·x)² var f₀₁
    gg, qq = g * g, dot(q, q)
    n = combination(w11, m, -2.0 * g, along)
    return (
        combination(g, k, -f, m),
        (
            gg * (va * (qq - q[0] * q[0]) + tilt * (X[0] * X[0] + Z[0] * Z[0])) + m[0] * n[0],
            2.0 * gg * (tilt * (X[0] * X[1] + Z[0] * Z[1]) - va * q[0] * q[1]) + m[0] * n[1] + m[1] * n[0],
            2.0 * gg * (tilt * (X[0] * X[2] + Z[0] * Z[2]) - va * q[0] * q[2]) + m[0] * n[2] + m[2] * n[0],
            gg * (va * (qq - q[1] * q[1]) + tilt * (X[1] * X[1] + Z[1] * Z[1])) + m[1] * n[1],
            2.0 * gg * (tilt * (X[1] * X[2] + Z[1] * Z[2]) - va * q[1] * q[2]) + m[1] * n[2] + m[2] * n[1],
            gg * (va * (qq - q[2] * q[2]) + tilt * (X[2] * X[2] + Z[2] * Z[2])) + m[2] * n[2],
        ),
        gg * dot(k, k),
    )


@scalar
def squared_ratio_of_forms(forms, ray, v):  # type: ignore[no-untyped-def]
    """Square of the resultant over its variance."""
    linear, (xx, xy, xz, yy, yz, zz), weight = forms
    x, y, z = ray
    value = dot(linear, ray)
    variance = x * (xx * x + xy * y + xz * z) + y * (yy * y + yz * z) + zz * z * z + weight * v
    ratio = value * value / variance
    return ratio if 0.0 <= ratio < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@kernel
def row(t, i, j, last, line):  # type: ignore[no-untyped-def]
    """Squares of the normalised resultants of the first pair with a source point and every target point."""
    p, u = t.points, t.rays
    d, e = difference(column(p, i[1]), column(p, i[0])), difference(column(p, last), column(p, i[0]))
    a, b = column(u, j[0]), column(u, j[1])
    va, vb, tilt = t.variance[j[0]], t.variance[j[1]], t.tilt_variance[0]
    alpha, beta, gamma = sinusoid(d, a, b)
    c1, s1, c2, s2 = roots(alpha, beta, gamma)
    one, two = quadratic_forms(c1, s1, d, e, a, b, va, vb, tilt), quadratic_forms(c2, s2, d, e, a, b, va, vb, tilt)
    x, y, z, v = u[0], u[1], u[2], t.variance
    for k in range(line.shape[0]):
        ray = x[k], y[k], z[k]
        line[k] = min(squared_ratio_of_forms(one, ray, v[k]), squared_ratio_of_forms(two, ray, v[k]))


slab = slab_kernel_of_rows(row, squared)

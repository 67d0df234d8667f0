"""One resultant of an upright hyper-edge in units of the noise, for every third image at once.

At a root θ of the first pair the resultant is linear in the third bearing x and its variance a quadratic form:
r² = (L·x)² / (xᵀ Q x + c v), v the variance of x. L, Q and c depend on the pair and the third source point alone: ten
numbers, found for all third points in one loop, after which a root costs sixteen operations an image.
"""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import cross, dot
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.pairs import edge_of_pairs, slab_of_edges
from rootmatch.problems.up2p.joint_residual import normalised_at, squared_at_both_roots
from rootmatch.problems.up2p.quadratic import roots, sinusoid

squared = edge_of_pairs(squared_at_both_roots(normalised_at), 2)
several = slab_of_edges(squared)


@kernel
def edge(t, kind, i, j):  # type: ignore[no-untyped-def]
    """Edge kernel of `Normalised`."""
    return np.sqrt(squared(t, kind, i, j))


@scalar
def forms_at(c, s, dx, dy, dz, ex, ey, ez, ax, ay, az, bx, by, bz, va, vb, tilt):  # type: ignore[no-untyped-def]
    """L, Q (xx, xy, xz, yy, yz, zz; off the diagonal twice) and c, for the differences 1 − 0 and 2 − 0 of the points.

    As `joint_residual.system`: with p and q these differences rotated, f₀₁ = (a × b) · p and f₀₂ = x · (q × a).
    """
    px, py, pz = c * dx + s * dz, dy, c * dz - s * dx
    qx, qy, qz = c * ex + s * ez, ey, c * ez - s * ex
    ux, uy, uz = cross(ax, ay, az, bx, by, bz)
    f, g = dot(ux, uy, uz, px, py, pz), ux * pz - uz * px
    kx, ky, kz = cross(qx, qy, qz, ax, ay, az)
    mx, my, mz = cross(qz, 0.0, -qx, ax, ay, az)
    # partials of f₀₁ in a, in b and in a tilt
    rx, ry, rz = cross(bx, by, bz, px, py, pz)
    hx, hy, hz = cross(px, py, pz, ax, ay, az)
    tx, tz = uy * pz - uz * py, ux * py - uy * px
    w11 = va * dot(rx, ry, rz, rx, ry, rz) + vb * dot(hx, hy, hz, hx, hy, hz) + tilt * (tx * tx + tz * tz)
    # those of f₀₂ are linear in x: q × x in a, and in a tilt x·X and x·Z
    aq = dot(ax, ay, az, qx, qy, qz)
    Xx, Xy, Xz = aq - ax * qx, -ax * qy, -ax * qz
    Zx, Zy, Zz = -az * qx, -az * qy, aq - az * qz
    ix, iy, iz = cross(qx, qy, qz, rx, ry, rz)
    cx = va * ix + tilt * (tx * Xx + tz * Zx)
    cy = va * iy + tilt * (tx * Xy + tz * Zy)
    cz = va * iz + tilt * (tx * Xz + tz * Zz)
    # g² var f₀₂ − 2 g m·x cov(f₀₁, f₀₂) + (m·x)² var f₀₁
    gg, qq = g * g, dot(qx, qy, qz, qx, qy, qz)
    nx, ny, nz = w11 * mx - 2.0 * g * cx, w11 * my - 2.0 * g * cy, w11 * mz - 2.0 * g * cz
    return (
        g * kx - f * mx,
        g * ky - f * my,
        g * kz - f * mz,
        gg * (va * (qq - qx * qx) + tilt * (Xx * Xx + Zx * Zx)) + mx * nx,
        2.0 * gg * (tilt * (Xx * Xy + Zx * Zy) - va * qx * qy) + mx * ny + my * nx,
        2.0 * gg * (tilt * (Xx * Xz + Zx * Zz) - va * qx * qz) + mx * nz + mz * nx,
        gg * (va * (qq - qy * qy) + tilt * (Xy * Xy + Zy * Zy)) + my * ny,
        2.0 * gg * (tilt * (Xy * Xz + Zy * Zz) - va * qy * qz) + my * nz + mz * ny,
        gg * (va * (qq - qz * qz) + tilt * (Xz * Xz + Zz * Zz)) + mz * nz,
        gg * dot(kx, ky, kz, kx, ky, kz),
    )


@scalar
def ratio_of(lx, ly, lz, xx, xy, xz, yy, yz, zz, weight, x, y, z, v):  # type: ignore[no-untyped-def]
    """Square of the resultant over its variance."""
    value = dot(lx, ly, lz, x, y, z)
    variance = x * (xx * x + xy * y + xz * z) + y * (yy * y + yz * z) + zz * z * z + weight * v
    ratio = value * value / variance
    return ratio if 0.0 <= ratio < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@kernel
def slab_of_pair(t, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
    """Squares of the normalised resultants of the first pair with every last correspondence."""
    p, u = t.points, t.rays
    X0, Y0, Z0 = p[0, i[0]], p[1, i[0]], p[2, i[0]]
    dx, dy, dz = p[0, i[1]] - X0, p[1, i[1]] - Y0, p[2, i[1]] - Z0
    ax, ay, az = u[0, j[0]], u[1, j[0]], u[2, j[0]]
    bx, by, bz = u[0, j[1]], u[1, j[1]], u[2, j[1]]
    va, vb, tilt = t.variance[j[0]], t.variance[j[1]], t.tilt_variance[0]
    alpha, beta, gamma = sinusoid(dx, dy, dz, ax, ay, az, bx, by, bz)
    c1, s1, c2, s2 = roots(alpha, beta, gamma)
    X, Y, Z = p[0, first:], p[1, first:], p[2, first:]
    for r in range(out.shape[0]):
        ex, ey, ez = X[r] - X0, Y[r] - Y0, Z[r] - Z0
        (
            scratch[0, r], scratch[1, r], scratch[2, r], scratch[3, r], scratch[4, r],
            scratch[5, r], scratch[6, r], scratch[7, r], scratch[8, r], scratch[9, r],
        ) = forms_at(c1, s1, dx, dy, dz, ex, ey, ez, ax, ay, az, bx, by, bz, va, vb, tilt)  # fmt: skip
        (
            scratch[10, r], scratch[11, r], scratch[12, r], scratch[13, r], scratch[14, r],
            scratch[15, r], scratch[16, r], scratch[17, r], scratch[18, r], scratch[19, r],
        ) = forms_at(c2, s2, dx, dy, dz, ex, ey, ez, ax, ay, az, bx, by, bz, va, vb, tilt)  # fmt: skip
    x, y, z, v = u[0], u[1], u[2], t.variance
    for r in range(out.shape[0]):
        line = out[r]
        k0, k1, k2, k3, k4 = scratch[0, r], scratch[1, r], scratch[2, r], scratch[3, r], scratch[4, r]
        k5, k6, k7, k8, k9 = scratch[5, r], scratch[6, r], scratch[7, r], scratch[8, r], scratch[9, r]
        l0, l1, l2, l3, l4 = scratch[10, r], scratch[11, r], scratch[12, r], scratch[13, r], scratch[14, r]
        l5, l6, l7, l8, l9 = scratch[15, r], scratch[16, r], scratch[17, r], scratch[18, r], scratch[19, r]
        for k in range(line.shape[0]):
            one = ratio_of(k0, k1, k2, k3, k4, k5, k6, k7, k8, k9, x[k], y[k], z[k], v[k])
            two = ratio_of(l0, l1, l2, l3, l4, l5, l6, l7, l8, l9, x[k], y[k], z[k], v[k])
            line[k] = min(one, two)


@kernel
def slab(t, kind, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
    """Slab kernel of `Normalised`: squares."""
    if kind.pairs == 1:
        slab_of_pair(t, i, j, first, scratch, out)
    else:
        several(t, kind, i, j, first, out)

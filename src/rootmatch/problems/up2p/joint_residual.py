"""Both constraints of an up2p hyper-edge at once, and what its other residuals share with them.

A hyper-edge of three correspondences has three equations like `quadratic` and one unknown: two constraints. They are
evaluated at both roots of the first pair, whose sines and cosines, and all that depends on them, are the same for every
third image point: a few products remain for each.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.algebra.vector import column, column4, cross, dot, rotated_about_y
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.pairs import edge_of_pairs, slab_of_rows
from rootmatch.problems.up2p.prediction import depths
from rootmatch.problems.up2p.quadratic import faces, roots, sinusoid


@scalar
def at_root(c, s, facing, X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, normal, ax, ay, az, bx, by, bz, va, vb, tilt):  # type: ignore[no-untyped-def]
    """Everything at one root of the first pair that does not depend on the third bearing."""
    # rotated differences p = RΔ01, q = RΔ02, r = RΔ12 and their derivatives in θ
    px, py, pz = rotated_about_y(c, s, X1 - X0, Y1 - Y0, Z1 - Z0)
    qx, qy, qz = rotated_about_y(c, s, X2 - X0, Y2 - Y0, Z2 - Z0)
    rx, ry, rz = qx - px, qy - py, qz - pz
    # (x, z) rotates to (c x + s z, c z − s x), so the derivative in θ of a rotated vector is (z, 0, −x)
    ux, uy, uz = cross(ax, ay, az, bx, by, bz)
    f01 = dot(ux, uy, uz, px, py, pz)
    g01 = ux * pz - uz * px
    # f02 = u2 · (q × a), f12 = u2 · (r × b); their slopes likewise
    kx, ky, kz = cross(qx, qy, qz, ax, ay, az)
    lx, ly, lz = cross(rx, ry, rz, bx, by, bz)
    mx, my, mz = cross(qz, 0.0, -qx, ax, ay, az)
    nx, ny, nz = cross(rz, 0.0, -rx, bx, by, bz)
    # partials of f01 in the bearings a and b: b × p and p × a
    gx, gy, gz = cross(bx, by, bz, px, py, pz)
    hx, hy, hz = cross(px, py, pz, ax, ay, az)
    w11 = va * dot(gx, gy, gz, gx, gy, gz) + vb * dot(hx, hy, hz, hx, hy, hz)
    # products of these with u2 × q and u2 × r
    ix, iy, iz = cross(qx, qy, qz, gx, gy, gz)
    jx, jy, jz = cross(rx, ry, rz, hx, hy, hz)
    w23 = -dot(kx, ky, kz, lx, ly, lz)
    w22 = dot(kx, ky, kz, kx, ky, kz)
    w33 = dot(lx, ly, lz, lx, ly, lz)
    # a tilt rotates all bearings together: ∂f/∂ω = n × d, of which x and z count
    tx = uy * pz - uz * py
    tz = ux * py - uy * px
    aq = dot(ax, ay, az, qx, qy, qz)
    br = dot(bx, by, bz, rx, ry, rz)
    depth0, depth1 = depths(ax, ay, az, bx, by, bz, px, py, pz)
    ox, oy, oz = depth0 * ax + qx, depth0 * ay + qy, depth0 * az + qz
    inverse = 1.0 / np.sqrt(dot(ox, oy, oz, ox, oy, oz))
    in_view = faces(c, s, normal, ox * inverse, oy * inverse, oz * inverse)
    front = facing and (depth0 > 0.0) and (depth1 > 0.0) and in_view
    return (
        f01, g01, kx, ky, kz, lx, ly, lz, mx, my, mz, nx, ny, nz,
        w11 + tilt * (tx * tx + tz * tz), ix, iy, iz, jx, jy, jz,
        w23, w22, w33, tx, tz, aq, br, qx, qy, qz, rx, ry, rz, front, ox, oy, oz,
    )  # fmt: skip


@scalar
def system(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v):  # type: ignore[no-untyped-def]
    """Values, slopes and covariance of f01, f02, f12 for the third bearing, and whether it looks at the point."""
    (
        f1, g1, kx, ky, kz, lx, ly, lz, mx, my, mz, nx, ny, nz, w11, ix, iy, iz, jx, jy, jz,
        w23, w22, w33, tx, tz, aq, br, qx, qy, qz, rx, ry, rz, front, ox, oy, oz,
    ) = root  # fmt: skip
    f2 = dot(x, y, z, kx, ky, kz)
    f3 = dot(x, y, z, lx, ly, lz)
    g2 = dot(x, y, z, mx, my, mz)
    g3 = dot(x, y, z, nx, ny, nz)
    sx, sy, sz = cross(x, y, z, qx, qy, qz)
    ux, uy, uz = cross(x, y, z, rx, ry, rz)
    xq = dot(x, y, z, qx, qy, qz)
    xr = dot(x, y, z, rx, ry, rz)
    # tilt: (a × u2) × q = u2 (a·q) − a (u2·q), x and z components
    ex, ez = x * aq - ax * xq, z * aq - az * xq
    hx, hz = x * br - bx * xr, z * br - bz * xr
    c12 = va * dot(x, y, z, ix, iy, iz) + tilt * (tx * ex + tz * ez)
    c13 = vb * dot(x, y, z, jx, jy, jz) + tilt * (tx * hx + tz * hz)
    c22 = va * dot(sx, sy, sz, sx, sy, sz) + v * w22 + tilt * (ex * ex + ez * ez)
    c33 = vb * dot(ux, uy, uz, ux, uy, uz) + v * w33 + tilt * (hx * hx + hz * hz)
    c23 = -v * w23 + tilt * (ex * hx + ez * hz)
    visible = front and (dot(x, y, z, ox, oy, oz) > 0.0)
    return f1, f2, f3, g1, g2, g3, w11, c12, c13, c22, c23, c33, visible


@scalar
def joint_at(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v):  # type: ignore[no-untyped-def]
    """χ² of both constraints at one root: Fᵀ W⁻¹ F less what a change of θ explains."""
    f1, f2, f3, g1, g2, g3, a, b, c, d, e, f, visible = system(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v)
    # adjugate of the covariance [[a b c] [b d e] [c e f]]
    m11 = d * f - e * e
    m12 = c * e - b * f
    m13 = b * e - c * d
    m22 = a * f - c * c
    m23 = b * c - a * e
    m33 = a * d - b * b
    determinant = a * m11 + b * m12 + c * m13
    hx = m11 * g1 + m12 * g2 + m13 * g3
    hy = m12 * g1 + m22 * g2 + m23 * g3
    hz = m13 * g1 + m23 * g2 + m33 * g3
    fmf = (
        f1 * (m11 * f1 + m12 * f2 + m13 * f3)
        + f2 * (m12 * f1 + m22 * f2 + m23 * f3)
        + f3 * (m13 * f1 + m23 * f2 + m33 * f3)
    )
    fmg = f1 * hx + f2 * hy + f3 * hz
    gmg = g1 * hx + g2 * hy + g3 * hz
    chi2 = (fmf - fmg * fmg / gmg) / determinant
    return chi2 if visible and chi2 >= 0.0 and chi2 < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@scalar
def normalised_at(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v):  # type: ignore[no-untyped-def]
    """Square of the resultant of f01 and f02 over its variance, at one root."""
    f1, f2, _, g1, g2, _, a, b, _, d, _, _, _ = system(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v)
    value = g1 * f2 - g2 * f1
    variance = g1 * g1 * d - 2.0 * g1 * g2 * b + g2 * g2 * a
    ratio = value * value / variance
    return ratio if ratio < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@scalar
def both_roots(t, i0, i1, i2, j0, j1):  # type: ignore[no-untyped-def]
    """`at_root` at the two roots of the pair (i0, j0), (i1, j1), with the numbers that `system` takes beside it."""
    p, u, m = t.points, t.rays, t.normals
    X0, Y0, Z0 = column(p, i0)
    X1, Y1, Z1 = column(p, i1)
    X2, Y2, Z2 = column(p, i2)
    ax, ay, az = column(u, j0)
    bx, by, bz = column(u, j1)
    m0, m1, m2 = column4(m, i0), column4(m, i1), column4(m, i2)
    va, vb, tilt = t.variance[j0], t.variance[j1], t.tilt_variance[0]
    alpha, beta, gamma = sinusoid(X1 - X0, Y1 - Y0, Z1 - Z0, ax, ay, az, bx, by, bz)
    c1, s1, c2, s2 = roots(alpha, beta, gamma)
    facing1 = faces(c1, s1, m0, ax, ay, az) and faces(c1, s1, m1, bx, by, bz)
    facing2 = faces(c2, s2, m0, ax, ay, az) and faces(c2, s2, m1, bx, by, bz)
    one = at_root(c1, s1, facing1, X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, m2, ax, ay, az, bx, by, bz, va, vb, tilt)
    two = at_root(c2, s2, facing2, X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, m2, ax, ay, az, bx, by, bz, va, vb, tilt)
    return one, two, ax, az, bx, bz, va, vb, tilt


def squared_at_both_roots(value: Any) -> Any:
    """Kernel of one pair ``(t, i, j, order)``: the lesser square at the two roots of the pair's first equation."""

    @scalar
    def squared(t, i, j, order):  # type: ignore[no-untyped-def]
        first, second, third = order
        one, two, ax, az, bx, bz, va, vb, tilt = both_roots(t, i[first], i[second], i[third], j[first], j[second])
        k = j[third]
        x, y, z, v = t.rays[0, k], t.rays[1, k], t.rays[2, k], t.variance[k]
        return min(
            value(one, ax, az, bx, bz, va, vb, tilt, x, y, z, v), value(two, ax, az, bx, bz, va, vb, tilt, x, y, z, v)
        )

    return squared


squared = edge_of_pairs(squared_at_both_roots(joint_at), 2)


@kernel
def edge(t, kind, i, j):  # type: ignore[no-untyped-def]
    """Edge kernel of `Joint`."""
    return np.sqrt(squared(t, kind, i, j))


@kernel
def row(t, i, j, last, line):  # type: ignore[no-untyped-def]
    """Squares of the residuals of the first pair with a source point and every target point."""
    one, two, ax, az, bx, bz, va, vb, tilt = both_roots(t, i[0], i[1], last, j[0], j[1])
    x, y, z, v = t.rays[0], t.rays[1], t.rays[2], t.variance
    for k in range(line.shape[0]):
        first = joint_at(one, ax, az, bx, bz, va, vb, tilt, x[k], y[k], z[k], v[k])
        second = joint_at(two, ax, az, bx, bz, va, vb, tilt, x[k], y[k], z[k], v[k])
        line[k] = min(first, second)


slab = slab_of_rows(row, squared)

"""Kernels of the upright two-point problem: the quadratic of a pair and the residuals of a triple of correspondences.

Camera and world are turned so that their verticals are the y axis. Two correspondences then bind the turn θ about it:
f = n · R(θ) Δ = α cos θ + β sin θ + γ = 0 with n = u₁ × u₂ and Δ = X₂ − X₁, a quadratic in x = tan(θ/2) (Kukelova et
al. 2011; paper, section "up2p"). A hyper-edge of three correspondences has three such equations and one unknown:
two constraints. They are evaluated at both roots of the first pair, whose sines and cosines, and all that
depends on them, are the same for every third image point: what remains for each is a few products.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.algebra.bezout import (
    NO_INFORMATION,
    smallest_singular_value_quadratic,
)
from rootmatch.algebra.vector import cross, dot
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.kernels import ResidualKernels
from rootmatch.problems.residual_dispatch import slab_of_rows

LARGE = 1e6
"""The residual of a hyper-edge that says nothing: no information is not agreement."""


@scalar
def sinusoid(dx, dy, dz, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """α, β, γ of the equation α cos θ + β sin θ + γ = 0 of difference d and bearings a, b."""
    nx = ay * bz - az * by
    ny = az * bx - ax * bz
    nz = ax * by - ay * bx
    return nx * dx + nz * dz, nx * dz - nz * dx, ny * dy


@scalar
def quadratic(dx, dy, dz, ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Coefficients in x = tan(θ/2), highest degree first."""
    alpha, beta, gamma = sinusoid(dx, dy, dz, ax, ay, az, bx, by, bz)
    return gamma - alpha, 2.0 * beta, gamma + alpha


@scalar
def roots(alpha, beta, gamma):  # type: ignore[no-untyped-def]
    """Cosine and sine of the two solutions; where noise left none, both are the point of nearest approach."""
    radius2 = alpha * alpha + beta * beta
    radius = np.sqrt(radius2)
    clipped = min(max(gamma, -radius), radius)
    half = np.sqrt(max(radius2 - gamma * gamma, 0.0))
    inverse = 1.0 / radius2
    return (
        (-clipped * alpha - beta * half) * inverse,
        (-clipped * beta + alpha * half) * inverse,
        (-clipped * alpha + beta * half) * inverse,
        (-clipped * beta - alpha * half) * inverse,
    )


@scalar
def faces(c, s, nx, ny, nz, x, y, z):  # type: ignore[no-untyped-def]
    """Whether a normal, turned about the vertical, does not look away along the bearing."""
    return (c * nx + s * nz) * x + ny * y + (c * nz - s * nx) * z <= 0.0


@scalar
def at_root(c, s, facing, X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, Nx, Ny, Nz, ax, ay, az, bx, by, bz, va, vb, tilt):  # type: ignore[no-untyped-def]
    """Everything at one root of the first pair that does not depend on the third bearing."""
    # turned differences p = RΔ01, q = RΔ02, r = RΔ12 and their derivatives in θ
    dx, dz = X1 - X0, Z1 - Z0
    px, py, pz = c * dx + s * dz, Y1 - Y0, c * dz - s * dx
    ex, ez = X2 - X0, Z2 - Z0
    qx, qy, qz = c * ex + s * ez, Y2 - Y0, c * ez - s * ex
    rx, ry, rz = qx - px, qy - py, qz - pz
    # (x, z) turns to (c x + s z, c z − s x), so the derivative in θ of a turned vector is (z, 0, −x)
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
    # the vertical turns all bearings together: ∂f/∂ω = n × d, of which x and z count
    tx = uy * pz - uz * py
    tz = ux * py - uy * px
    aq = dot(ax, ay, az, qx, qy, qz)
    br = dot(bx, by, bz, rx, ry, rz)
    # depths: a's ray meets point 0 at the parameter that puts point 1 on b's
    bb = dot(ax, ay, az, bx, by, bz)
    bp = dot(bx, by, bz, px, py, pz)
    ap = dot(ax, ay, az, px, py, pz)
    depth0 = (bb * bp - ap) / (1.0 - bb * bb)
    depth1 = (bp - bb * ap) / (1.0 - bb * bb)
    ox, oy, oz = depth0 * ax + qx, depth0 * ay + qy, depth0 * az + qz
    front = facing and (depth0 > 0.0) and (depth1 > 0.0) and faces(c, s, Nx, Ny, Nz, ox, oy, oz)
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
    seen = front and (dot(x, y, z, ox, oy, oz) > 0.0)
    return f1, f2, f3, g1, g2, g3, w11, c12, c13, c22, c23, c33, seen


@scalar
def joint_at(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v):  # type: ignore[no-untyped-def]
    """χ² of both constraints at one root: Fᵀ W⁻¹ F less what a change of θ explains."""
    f1, f2, f3, g1, g2, g3, a, b, c, d, e, f, seen = system(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v)
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
    return chi2 if seen and chi2 >= 0.0 and chi2 < LARGE * LARGE else LARGE * LARGE


@scalar
def normalised_at(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v):  # type: ignore[no-untyped-def]
    """Square of the resultant of f01 and f02 over its variance, at one root."""
    f1, f2, _, g1, g2, _, a, b, _, d, _, _, _ = system(root, ax, az, bx, bz, va, vb, tilt, x, y, z, v)
    value = g1 * f2 - g2 * f1
    variance = g1 * g1 * d - 2.0 * g1 * g2 * b + g2 * g2 * a
    ratio = value * value / variance
    return ratio if ratio < LARGE * LARGE else LARGE * LARGE


SHARED_FIRST = ((0, 1, 2), (1, 0, 2), (2, 0, 1))
"""Orders of a triple, one for each pair of its three quadratics: those of (0, 1) and (0, 2) in the new order."""


@scalar
def both_roots(t, i0, i1, i2, j0, j1):  # type: ignore[no-untyped-def]
    """What the third bearing meets at the two roots of the pair (i0, j0), (i1, j1)."""
    p = t.points
    u = t.rays
    X0, Y0, Z0 = p[0, i0], p[1, i0], p[2, i0]
    X1, Y1, Z1 = p[0, i1], p[1, i1], p[2, i1]
    X2, Y2, Z2 = p[0, i2], p[1, i2], p[2, i2]
    ax, ay, az = u[0, j0], u[1, j0], u[2, j0]
    bx, by, bz = u[0, j1], u[1, j1], u[2, j1]
    va, vb, tilt = t.variance[j0], t.variance[j1], t.tilt_variance[0]
    alpha, beta, gamma = sinusoid(X1 - X0, Y1 - Y0, Z1 - Z0, ax, ay, az, bx, by, bz)
    c1, s1, c2, s2 = roots(alpha, beta, gamma)
    m = t.normals
    faces1 = faces(c1, s1, m[0, i0], m[1, i0], m[2, i0], ax, ay, az) and faces(
        c1, s1, m[0, i1], m[1, i1], m[2, i1], bx, by, bz
    )
    faces2 = faces(c2, s2, m[0, i0], m[1, i0], m[2, i0], ax, ay, az) and faces(
        c2, s2, m[0, i1], m[1, i1], m[2, i1], bx, by, bz
    )
    Nx, Ny, Nz = m[0, i2], m[1, i2], m[2, i2]
    one = at_root(c1, s1, faces1, X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, Nx, Ny, Nz, ax, ay, az, bx, by, bz, va, vb, tilt)
    two = at_root(c2, s2, faces2, X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, Nx, Ny, Nz, ax, ay, az, bx, by, bz, va, vb, tilt)
    return one, two, ax, az, bx, bz, va, vb, tilt


def rooted_edge(value: Any) -> Any:
    """Edge kernel of a residual that is evaluated at both roots of the first pair."""

    @scalar
    def at(t, i0, i1, i2, j0, j1, j2):  # type: ignore[no-untyped-def]
        one, two, ax, az, bx, bz, va, vb, tilt = both_roots(t, i0, i1, i2, j0, j1)
        x, y, z, v = t.rays[0, j2], t.rays[1, j2], t.rays[2, j2], t.variance[j2]
        first = value(one, ax, az, bx, bz, va, vb, tilt, x, y, z, v)
        return np.sqrt(min(first, value(two, ax, az, bx, bz, va, vb, tilt, x, y, z, v)))

    @kernel
    def edge(t, kind, i, j):  # type: ignore[no-untyped-def]
        worst = -1.0
        for pair in range(3):
            if kind.pairs >> pair & 1:
                a, b, c = SHARED_FIRST[pair]
                worst = max(worst, at(t, i[a], i[b], i[c], j[a], j[b], j[c]))
        return worst

    return edge


edge_joint = rooted_edge(joint_at)


@kernel
def row_joint(t, kind, i, j, out):  # type: ignore[no-untyped-def]
    """Row kernel of `Joint`: squares."""
    if kind.pairs == 1:
        one, two, ax, az, bx, bz, va, vb, tilt = both_roots(t, i[0], i[1], i[2], j[0], j[1])
        x, y, z, v = t.rays[0], t.rays[1], t.rays[2], t.variance
        for k in range(out.shape[0]):
            first = joint_at(one, ax, az, bx, bz, va, vb, tilt, x[k], y[k], z[k], v[k])
            second = joint_at(two, ax, az, bx, bz, va, vb, tilt, x[k], y[k], z[k], v[k])
            out[k] = min(first, second)
    else:
        for k in range(out.shape[0]):
            out[k] = edge_joint(t, kind, i, (j[0], j[1], k)) ** 2


@scalar
def singular_value(p2, p1, p0, q2, q1, q0):  # type: ignore[no-untyped-def]
    """Least singular value of the 4×4 Sylvester matrix of two quadratics scaled to unit norm."""
    i = 1.0 / np.sqrt(p2 * p2 + p1 * p1 + p0 * p0)
    j = 1.0 / np.sqrt(q2 * q2 + q1 * q1 + q0 * q0)
    least = smallest_singular_value_quadratic(i * p2, i * p1, i * p0, j * q2, j * q1, j * q0)
    # a zero polynomial has no unit form: no information
    return least if i < LARGE * LARGE and j < LARGE * LARGE else NO_INFORMATION


@scalar
def quadratic_of(t, i0, i1, j0, j1):  # type: ignore[no-untyped-def]
    """The quadratic of the correspondences (i0, j0) and (i1, j1)."""
    p = t.points
    u = t.rays
    return quadratic(
        p[0, i1] - p[0, i0], p[1, i1] - p[1, i0], p[2, i1] - p[2, i0],
        u[0, j0], u[1, j0], u[2, j0], u[0, j1], u[1, j1], u[2, j1],
    )  # fmt: skip


def resultant_kernels(value: Any) -> ResidualKernels:
    """Edge and slab kernels of a residual that compares the quadratics alone."""

    @kernel
    def edge(t, kind, i, j):  # type: ignore[no-untyped-def]
        worst = -1.0
        for pair in range(3):
            if kind.pairs >> pair & 1:
                a, b, c = SHARED_FIRST[pair]
                p2, p1, p0 = quadratic_of(t, i[a], i[b], j[a], j[b])
                q2, q1, q0 = quadratic_of(t, i[a], i[c], j[a], j[c])
                worst = max(worst, value(p2, p1, p0, q2, q1, q0))
        return worst

    @kernel
    def row(t, kind, i, j, out):  # type: ignore[no-untyped-def]
        if kind.pairs == 1:
            p = t.points
            u = t.rays
            dx, dy, dz = p[0, i[2]] - p[0, i[0]], p[1, i[2]] - p[1, i[0]], p[2, i[2]] - p[2, i[0]]
            ax, ay, az = u[0, j[0]], u[1, j[0]], u[2, j[0]]
            p2, p1, p0 = quadratic_of(t, i[0], i[1], j[0], j[1])
            x, y, z = u[0], u[1], u[2]
            for k in range(out.shape[0]):
                q2, q1, q0 = quadratic(dx, dy, dz, ax, ay, az, x[k], y[k], z[k])
                out[k] = value(p2, p1, p0, q2, q1, q0)
        else:
            for k in range(out.shape[0]):
                out[k] = edge(t, kind, i, (j[0], j[1], k))

    return ResidualKernels(edge, slab_of_rows(row))

"""Both constraints of a P3P hyper-edge at once, by carrying a triple's solution to the fourth point.

A 4-tuple has eight image coordinates and six unknowns of the pose, so two independent constraints. At a root of the
quartic of abc the triple's place in the camera frame is known and so is that of d; the two coordinates of d's bearing
across the predicted one are the constraints, and their covariance follows from the bearings' noise through the implicit
derivative of the depths. To first order this is the χ² of all resultants of the 4-tuple together, but linearised at a
solution of the triple instead of at a root blurred by the other quartic: where a triple has two near solutions (a
distant camera sees each triangle and its reversal) the null vector of the Bézout matrix mixes them, and 15 to 40 % of
the true hyper-edges were lost. All that depends on abc is computed once for every d and every image of it.
"""

from __future__ import annotations

from math import inf

import numpy as np

from rootmatch.algebra.vector import cross, dot
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.p3p.resultant import LARGE
from rootmatch.problems.p3p.roots import ratio_pairs, solve_all

VAGUE2 = 1e-2
"""Variance, in radians², of a prediction beyond which it says nothing about where the fourth point is."""


@scalar
def solution_frame(A, x, y, hab, ax, ay, az, bx, by, bz, cx, cy, cz):  # type: ignore[no-untyped-def]
    """The triple in the camera frame at one solution, and the inverse of the depths' derivative.

    Returns the depth of a, the vectors from a to b and to c, and the rows of M⁻¹, where M dλ is the change of the three
    squared distances (halved) with the depths λ.
    """
    depth = np.sqrt(A / ((x - 1.0) * (x - 1.0) + 2.0 * hab * x))
    db = depth * x
    dc = depth * y
    ex, ey, ez = db * bx - depth * ax, db * by - depth * ay, db * bz - depth * az
    fx, fy, fz = dc * cx - depth * ax, dc * cy - depth * ay, dc * cz - depth * az
    gx, gy, gz = fx - ex, fy - ey, fz - ez
    # rows: ab (−e·a, e·b, 0), ca (−f·a, 0, f·c), bc (0, −g·b, g·c)
    ea = -dot(ex, ey, ez, ax, ay, az)
    eb = dot(ex, ey, ez, bx, by, bz)
    fa = -dot(fx, fy, fz, ax, ay, az)
    fc = dot(fx, fy, fz, cx, cy, cz)
    gb = -dot(gx, gy, gz, bx, by, bz)
    gc = dot(gx, gy, gz, cx, cy, cz)
    inverse = -1.0 / (ea * fc * gb + eb * fa * gc)
    return (
        depth, db, dc, ex, ey, ez, fx, fy, fz,
        -fc * gb * inverse, -eb * gc * inverse, eb * fc * inverse,
        -fa * gc * inverse, ea * gc * inverse, -ea * fc * inverse,
        fa * gb * inverse, -ea * gb * inverse, -eb * fa * inverse,
    )  # fmt: skip


@scalar
def adjoint(px, py, pz, alpha, beta, gamma, frame, ax, ay, az, bx, by, bz, cx, cy, cz):  # type: ignore[no-untyped-def]
    """Partials in the three bearings of the component along (px, py, pz) of the predicted point."""
    depth, db, dc, ex, ey, ez, fx, fy, fz, i00, i01, i02, i10, i11, i12, i20, i21, i22 = frame
    # the point is a + α e + β f + γ e × f
    ux, uy, uz = cross(fx, fy, fz, px, py, pz)
    vx, vy, vz = cross(px, py, pz, ex, ey, ez)
    ux, uy, uz = alpha * px + gamma * ux, alpha * py + gamma * uy, alpha * pz + gamma * uz
    vx, vy, vz = beta * px + gamma * vx, beta * py + gamma * vy, beta * pz + gamma * vz
    wx, wy, wz = px - ux - vx, py - uy - vy, pz - uz - vz
    # depths follow the bearings so that the three distances stay: multipliers μ = M⁻ᵀ (u_k · partial_k)
    qa = dot(wx, wy, wz, ax, ay, az)
    qb = dot(ux, uy, uz, bx, by, bz)
    qc = dot(vx, vy, vz, cx, cy, cz)
    m0 = i00 * qa + i10 * qb + i20 * qc
    m1 = i01 * qa + i11 * qb + i21 * qc
    m2 = i02 * qa + i12 * qb + i22 * qc
    gx, gy, gz = fx - ex, fy - ey, fz - ez
    return (
        depth * (wx + m0 * ex + m1 * fx), depth * (wy + m0 * ey + m1 * fy), depth * (wz + m0 * ez + m1 * fz),
        db * (ux - m0 * ex + m2 * gx), db * (uy - m0 * ey + m2 * gy), db * (uz - m0 * ez + m2 * gz),
        dc * (vx - m1 * fx - m2 * gx), dc * (vy - m1 * fy - m2 * gy), dc * (vz - m1 * fz - m2 * gz),
    )  # fmt: skip


@scalar
def predict(alpha, beta, gamma, frame, ax, ay, az, bx, by, bz, cx, cy, cz, va, vb, vc):  # type: ignore[no-untyped-def]
    """Where the fourth point must be seen: bearing, two axes across it, and the covariance along them in radians²."""
    depth, _, _, ex, ey, ez, fx, fy, fz, _, _, _, _, _, _, _, _, _ = frame
    nx, ny, nz = cross(ex, ey, ez, fx, fy, fz)
    dx = depth * ax + alpha * ex + beta * fx + gamma * nx
    dy = depth * ay + alpha * ey + beta * fy + gamma * ny
    dz = depth * az + alpha * ez + beta * fz + gamma * nz
    inverse = 1.0 / np.sqrt(dot(dx, dy, dz, dx, dy, dz))
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    # an axis across d without a branch (Duff et al. 2017)
    sign = 1.0 if dz >= 0.0 else -1.0
    p = -1.0 / (sign + dz)
    q = dx * dy * p
    px, py, pz = 1.0 + sign * dx * dx * p, sign * q, -sign * dx
    qx, qy, qz = q, sign + dy * dy * p, -dy
    ux, uy, uz, vx, vy, vz, wx, wy, wz = adjoint(
        px * inverse, py * inverse, pz * inverse, alpha, beta, gamma, frame, ax, ay, az, bx, by, bz, cx, cy, cz
    )
    kx, ky, kz, lx, ly, lz, mx, my, mz = adjoint(
        qx * inverse, qy * inverse, qz * inverse, alpha, beta, gamma, frame, ax, ay, az, bx, by, bz, cx, cy, cz
    )
    s11 = va * dot(ux, uy, uz, ux, uy, uz) + vb * dot(vx, vy, vz, vx, vy, vz) + vc * dot(wx, wy, wz, wx, wy, wz)
    s12 = va * dot(ux, uy, uz, kx, ky, kz) + vb * dot(vx, vy, vz, lx, ly, lz) + vc * dot(wx, wy, wz, mx, my, mz)
    s22 = va * dot(kx, ky, kz, kx, ky, kz) + vb * dot(lx, ly, lz, lx, ly, lz) + vc * dot(mx, my, mz, mx, my, mz)
    return dx, dy, dz, px, py, pz, qx, qy, qz, s11, s12, s22


@scalar
def mahalanobis2(dx, dy, dz, px, py, pz, qx, qy, qz, s11, s12, s22, x, y, z, v):  # type: ignore[no-untyped-def]
    """χ² of the bearing (x, y, z) of variance v about the predicted one; LARGE² behind the camera or if too vague."""
    f = dot(px, py, pz, x, y, z)
    g = dot(qx, qy, qz, x, y, z)
    a = s11 + v
    b = s22 + v
    determinant = a * b - s12 * s12
    chi2 = (f * f * b - 2.0 * f * g * s12 + g * g * a) / determinant
    known = (a + b < VAGUE2) and (dot(dx, dy, dz, x, y, z) > 0.0) and (chi2 >= 0.0)
    return chi2 if known else LARGE * LARGE


@scalar
def backward(affine, frame, normal, px, py, pz):  # type: ignore[no-untyped-def]
    """Product of a source point's normal, turned as the triple, with its place p: positive when it looks away."""
    ox, oy, oz, _, _, _, _, _, _, _, _, _, _, _, _ = affine
    alpha, beta, gamma = affine_coordinates(affine, normal[0] + ox, normal[1] + oy, normal[2] + oz)
    _, _, _, ex, ey, ez, fx, fy, fz, _, _, _, _, _, _, _, _, _ = frame
    gx, gy, gz = cross(ex, ey, ez, fx, fy, fz)
    return dot(
        alpha * ex + beta * fx + gamma * gx,
        alpha * ey + beta * fy + gamma * gy,
        alpha * ez + beta * fz + gamma * gz,
        px,
        py,
        pz,
    )


@scalar
def looks_back(t, affine, frame, k, px, py, pz):  # type: ignore[no-untyped-def]
    """`backward` of point k of the tables."""
    return backward(affine, frame, (t.normals[0, k], t.normals[1, k], t.normals[2, k]), px, py, pz)


@scalar
def triple_faces(t, affine, frame, i, ax, ay, az, bx, by, bz, cx, cy, cz):  # type: ignore[no-untyped-def]
    """Whether all three points of the triple show their front to the camera."""
    worst = looks_back(t, affine, frame, i[0], ax, ay, az)
    worst = max(worst, looks_back(t, affine, frame, i[1], bx, by, bz))
    worst = max(worst, looks_back(t, affine, frame, i[2], cx, cy, cz))
    return worst <= 0.0


@scalar
def affine_of(a, b, c):  # type: ignore[no-untyped-def]
    """Three source points as a frame: origin, e, f, e × f, and the inverse Gram matrix of e and f."""
    ox, oy, oz = a
    ex, ey, ez = b[0] - ox, b[1] - oy, b[2] - oz
    fx, fy, fz = c[0] - ox, c[1] - oy, c[2] - oz
    nx, ny, nz = cross(ex, ey, ez, fx, fy, fz)
    n2 = 1.0 / dot(nx, ny, nz, nx, ny, nz)
    ee = dot(ex, ey, ez, ex, ey, ez) * n2
    ff = dot(fx, fy, fz, fx, fy, fz) * n2
    ef = dot(ex, ey, ez, fx, fy, fz) * n2
    return ox, oy, oz, ex, ey, ez, fx, fy, fz, nx * n2, ny * n2, nz * n2, ee, ff, ef


@scalar
def affine_frame(t, a, b, c):  # type: ignore[no-untyped-def]
    """`affine_of` three points of the tables."""
    s = t.points
    return affine_of((s[0, a], s[1, a], s[2, a]), (s[0, b], s[1, b], s[2, b]), (s[0, c], s[1, c], s[2, c]))


@scalar
def affine_coordinates(affine, x, y, z):  # type: ignore[no-untyped-def]
    """Coordinates α, β, γ of a source point in the frame of a triple."""
    ox, oy, oz, ex, ey, ez, fx, fy, fz, nx, ny, nz, ee, ff, ef = affine
    x, y, z = x - ox, y - oy, z - oz
    e = dot(ex, ey, ez, x, y, z)
    f = dot(fx, fy, fz, x, y, z)
    return ff * e - ef * f, ee * f - ef * e, dot(nx, ny, nz, x, y, z)


@kernel
def slab_joint(t, kind, i, j, first, panel, scratch, out):  # type: ignore[no-untyped-def]
    """Slab kernel of `Joint`: squares."""
    s = t.distance2
    h = t.versine
    u = t.rays
    v = t.variance
    rows, columns = out.shape
    A = s[i[0], i[1]]
    hab = h[j[0], j[1]]
    ax, ay, az = u[0, j[0]], u[1, j[0]], u[2, j[0]]
    bx, by, bz = u[0, j[1]], u[1, j[1]], u[2, j[1]]
    cx, cy, cz = u[0, j[2]], u[1, j[2]], u[2, j[2]]
    va, vb, vc = v[j[0]], v[j[1]], v[j[2]]
    affine = affine_frame(t, i[0], i[1], i[2])
    px, py, pz = t.points[0, first:], t.points[1, first:], t.points[2, first:]
    rx, ry, rz = u[0], u[1], u[2]
    for r in range(rows):
        for m in range(columns):
            out[r, m] = LARGE * LARGE
    for k in range(4):
        x, y = panel[2 * k, j[2]], panel[2 * k + 1, j[2]]
        if not (x > 0.0 and y > 0.0):
            continue
        frame = solution_frame(A, x, y, hab, ax, ay, az, bx, by, bz, cx, cy, cz)
        if not triple_faces(t, affine, frame, i, ax, ay, az, bx, by, bz, cx, cy, cz):
            continue
        for r in range(rows):
            alpha, beta, gamma = affine_coordinates(affine, px[r], py[r], pz[r])
            (
                scratch[0, r], scratch[1, r], scratch[2, r], scratch[3, r], scratch[4, r], scratch[5, r],
                scratch[6, r], scratch[7, r], scratch[8, r], scratch[9, r], scratch[10, r], scratch[11, r],
            ) = predict(alpha, beta, gamma, frame, ax, ay, az, bx, by, bz, cx, cy, cz, va, vb, vc)  # fmt: skip
            if looks_back(t, affine, frame, first + r, scratch[0, r], scratch[1, r], scratch[2, r]) > 0.0:
                scratch[9, r] = inf  # a prediction without meaning
        for r in range(rows):
            d0, d1, d2, d3, d4, d5 = (
                scratch[0, r],
                scratch[1, r],
                scratch[2, r],
                scratch[3, r],
                scratch[4, r],
                scratch[5, r],
            )
            d6, d7, d8, d9, d10, d11 = (
                scratch[6, r],
                scratch[7, r],
                scratch[8, r],
                scratch[9, r],
                scratch[10, r],
                scratch[11, r],
            )
            line = out[r]
            for m in range(columns):
                chi2 = mahalanobis2(d0, d1, d2, d3, d4, d5, d6, d7, d8, d9, d10, d11, rx[m], ry[m], rz[m], v[m])
                line[m] = min(line[m], chi2)


@kernel
def edge_joint(t, kind, i, j):  # type: ignore[no-untyped-def]
    """Edge kernel of `Joint`; whichever triple predicts, the constraints are the same to first order."""
    s = t.distance2
    h = t.versine
    u = t.rays
    v = t.variance
    A = s[i[0], i[1]]
    hab = h[j[0], j[1]]
    ratios = ratio_pairs(A, s[i[1], i[2]], s[i[0], i[2]], hab, h[j[1], j[2]], h[j[0], j[2]])
    ax, ay, az = u[0, j[0]], u[1, j[0]], u[2, j[0]]
    bx, by, bz = u[0, j[1]], u[1, j[1]], u[2, j[1]]
    cx, cy, cz = u[0, j[2]], u[1, j[2]], u[2, j[2]]
    d, k = i[3], j[3]
    affine = affine_frame(t, i[0], i[1], i[2])
    alpha, beta, gamma = affine_coordinates(affine, t.points[0, d], t.points[1, d], t.points[2, d])
    least = LARGE * LARGE
    for r in range(4):
        x, y = ratios[2 * r], ratios[2 * r + 1]
        if x > 0.0 and y > 0.0:
            frame = solution_frame(A, x, y, hab, ax, ay, az, bx, by, bz, cx, cy, cz)
            if not triple_faces(t, affine, frame, i, ax, ay, az, bx, by, bz, cx, cy, cz):
                continue
            d0, d1, d2, d3, d4, d5, d6, d7, d8, d9, d10, d11 = predict(
                alpha, beta, gamma, frame, ax, ay, az, bx, by, bz, cx, cy, cz, v[j[0]], v[j[1]], v[j[2]]
            )
            if looks_back(t, affine, frame, d, d0, d1, d2) > 0.0:
                continue
            chi2 = mahalanobis2(d0, d1, d2, d3, d4, d5, d6, d7, d8, d9, d10, d11, u[0, k], u[1, k], u[2, k], v[k])
            least = min(least, chi2)
    return np.sqrt(least)


@kernel
def panel_joint(t, kind, i, j, panel):  # type: ignore[no-untyped-def]
    """Panel kernel of `Joint`: the roots for every third image."""
    s = t.distance2
    h = t.versine
    solve_all(s[i[0], i[1]], s[i[1], i[2]], s[i[0], i[2]], h[j[0], j[1]], h[j[1]], h[j[0]], panel)

"""Where further points are visible, by one solution of a P3P triple: the prediction and its covariance.

At a root of the quartic of abc the triple's position in the camera frame is known, and with it that of every other
source point: its coordinates in the triple's own frame do not change. The covariance of the predicted bearing follows
from the noise of the three bearings through the implicit derivative of the depths. The joint residual compares the
prediction with a detection, one hyper-edge at a time, in slabs, or in lists; the guided search predicts all points.
"""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import column, column4, cross, dot, tangent_basis
from rootmatch.jit.decorators import scalar
from rootmatch.problems.limits import UNINFORMATIVE, VAGUE2


@scalar
def source_frame(a, b, c):  # type: ignore[no-untyped-def]
    """Three source points as a frame: origin, e, f, e × f over its square, and the inverse Gram matrix of e and f."""
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
def source_coordinates(source, x, y, z):  # type: ignore[no-untyped-def]
    """Coordinates α, β, γ of a vector from the frame's origin: α e + β f + γ e × f."""
    _, _, _, ex, ey, ez, fx, fy, fz, nx, ny, nz, ee, ff, ef = source
    e = dot(ex, ey, ez, x, y, z)
    f = dot(fx, fy, fz, x, y, z)
    return ff * e - ef * f, ee * f - ef * e, dot(nx, ny, nz, x, y, z)


@scalar
def camera_triangle(ab2, hab, x, y, a, b, c):  # type: ignore[no-untyped-def]
    """Depths of a triple along its bearings at a solution x = b/a, y = c/a, and the vectors e and f from a to b and c.

    ``ab2``: squared distance of the source points a and b; ``hab``: versine of the angle between their bearings.
    """
    depth = np.sqrt(ab2 / ((x - 1.0) * (x - 1.0) + 2.0 * hab * x))
    db = depth * x
    dc = depth * y
    ox, oy, oz = depth * a[0], depth * a[1], depth * a[2]
    e = (db * b[0] - ox, db * b[1] - oy, db * b[2] - oz)
    f = (dc * c[0] - ox, dc * c[1] - oy, dc * c[2] - oz)
    return depth, db, dc, e, f


@scalar
def camera_frame(ab2, hab, x, y, rays):  # type: ignore[no-untyped-def]
    """The triple in the camera frame at one solution, and the inverse of the depths' derivative.

    Returns the depths, the vectors from a to b and to c, and the rows of M⁻¹, where M dλ is the change of the three
    squared distances (halved) with the depths λ.
    """
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = rays
    depth, db, dc, (ex, ey, ez), (fx, fy, fz) = camera_triangle(ab2, hab, x, y, rays[0], rays[1], rays[2])
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
def partials(px, py, pz, alpha, beta, gamma, frame, rays):  # type: ignore[no-untyped-def]
    """Partials in the three bearings of the component along (px, py, pz) of a point with source coordinates α, β, γ."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = rays
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
def prediction(source, frame, rays, variances, point):  # type: ignore[no-untyped-def]
    """Predicted bearing of a source point, two axes orthogonal to it, and the covariance along them in radians².

    Twelve numbers: the bearing's three, those of each axis, and s11, s12, s22.
    """
    ax, ay, az = rays[0]
    va, vb, vc = variances
    alpha, beta, gamma = source_coordinates(source, point[0] - source[0], point[1] - source[1], point[2] - source[2])
    depth, _, _, ex, ey, ez, fx, fy, fz, _, _, _, _, _, _, _, _, _ = frame
    nx, ny, nz = cross(ex, ey, ez, fx, fy, fz)
    dx = depth * ax + alpha * ex + beta * fx + gamma * nx
    dy = depth * ay + alpha * ey + beta * fy + gamma * ny
    dz = depth * az + alpha * ez + beta * fz + gamma * nz
    inverse = 1.0 / np.sqrt(dot(dx, dy, dz, dx, dy, dz))
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    (px, py, pz), (qx, qy, qz) = tangent_basis(dx, dy, dz)
    ux, uy, uz, vx, vy, vz, wx, wy, wz = partials(
        px * inverse, py * inverse, pz * inverse, alpha, beta, gamma, frame, rays
    )
    kx, ky, kz, lx, ly, lz, mx, my, mz = partials(
        qx * inverse, qy * inverse, qz * inverse, alpha, beta, gamma, frame, rays
    )
    s11 = va * dot(ux, uy, uz, ux, uy, uz) + vb * dot(vx, vy, vz, vx, vy, vz) + vc * dot(wx, wy, wz, wx, wy, wz)
    s12 = va * dot(ux, uy, uz, kx, ky, kz) + vb * dot(vx, vy, vz, lx, ly, lz) + vc * dot(wx, wy, wz, mx, my, mz)
    s22 = va * dot(kx, ky, kz, kx, ky, kz) + vb * dot(lx, ly, lz, lx, ly, lz) + vc * dot(mx, my, mz, mx, my, mz)
    return dx, dy, dz, px, py, pz, qx, qy, qz, s11, s12, s22


@scalar
def squared_deviation(predicted, x, y, z, v):  # type: ignore[no-untyped-def]
    """χ² of a bearing (x, y, z) of variance v about a prediction; UNINFORMATIVE² behind the camera or if too vague."""
    dx, dy, dz, px, py, pz, qx, qy, qz, s11, s12, s22 = predicted
    f = dot(px, py, pz, x, y, z)
    g = dot(qx, qy, qz, x, y, z)
    a = s11 + v
    b = s22 + v
    determinant = a * b - s12 * s12
    chi2 = (f * f * b - 2.0 * f * g * s12 + g * g * a) / determinant
    known = (a + b < VAGUE2) and (dot(dx, dy, dz, x, y, z) > 0.0) and (chi2 >= 0.0)
    return chi2 if known else UNINFORMATIVE * UNINFORMATIVE


@scalar
def facing_away(source, frame, normal, x, y, z):  # type: ignore[no-untyped-def]
    """Positive where a source point's normal, rotated as the triple is, is beyond its view angle for a unit bearing."""
    alpha, beta, gamma = source_coordinates(source, normal[0], normal[1], normal[2])
    _, _, _, ex, ey, ez, fx, fy, fz, _, _, _, _, _, _, _, _, _ = frame
    gx, gy, gz = cross(ex, ey, ez, fx, fy, fz)
    return (
        dot(
            alpha * ex + beta * fx + gamma * gx,
            alpha * ey + beta * fy + gamma * gy,
            alpha * ez + beta * fz + gamma * gz,
            x,
            y,
            z,
        )
        + normal[3]
    )


@scalar
def triple_visible(source, frame, normals, rays):  # type: ignore[no-untyped-def]
    """Whether none of the triple's own points faces away."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = rays
    return (
        (facing_away(source, frame, normals[0], ax, ay, az) <= 0.0)
        & (facing_away(source, frame, normals[1], bx, by, bz) <= 0.0)
        & (facing_away(source, frame, normals[2], cx, cy, cz) <= 0.0)
    )


@scalar
def triple_of(t, i, j):  # type: ignore[no-untyped-def]
    """A triple as the tables have it: |ab|², the versine of a and b, source frame, normals, bearings, variances."""
    p, m, u, v = t.points, t.normals, t.rays, t.variance
    return (
        t.distance2[i[0], i[1]],
        t.versine[j[0], j[1]],
        source_frame(column(p, i[0]), column(p, i[1]), column(p, i[2])),
        (column4(m, i[0]), column4(m, i[1]), column4(m, i[2])),
        (column(u, j[0]), column(u, j[1]), column(u, j[2])),
        (v[j[0]], v[j[1]], v[j[2]]),
    )


@scalar
def stored(predicted, rows, k):  # type: ignore[no-untyped-def]
    """Write a prediction to rows 0 to 11 of column k."""
    (
        rows[0, k], rows[1, k], rows[2, k], rows[3, k], rows[4, k], rows[5, k],
        rows[6, k], rows[7, k], rows[8, k], rows[9, k], rows[10, k], rows[11, k],
    ) = predicted  # fmt: skip

"""Images of a body's points in several poses and cameras, to first order, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part

PINHOLE, KANNALA_BRANDT, BROWN, STEREOGRAPHIC = range(4)
"""Kinds of cameras."""
NUMBERS = 17
"""Most numbers of a camera: focal lengths and principal point, and the 13 of a lens."""
NEAR_AXIS = 1e-150
"""Distance from the optical axis below which the image of a fisheye lens is that of a pinhole."""


@part
def project_fisheye(numbers, x, y, z):  # type: ignore[no-untyped-def]
    """Image of a direction by Kannala and Brandt, in focal lengths: whether it is seen, u, v, and their derivatives."""
    across = math.sqrt(x * x + y * y)
    angle = math.atan2(across, z)
    s = angle * angle
    k1, k2, k3, k4 = numbers[4], numbers[5], numbers[6], numbers[7]
    value = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    slope = 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
    scale = value / across if across > NEAR_AXIS else 1.0 / z
    divisor = across if across > 0.0 else 1.0
    a, b = x / divisor, y / divisor
    slope /= across * across + z * z
    p, q, r = z * a * slope, z * b * slope, -across * slope
    u1, u2, u3 = a * p + scale * (1.0 - a * a), a * q - scale * a * b, a * r
    v1, v2, v3 = b * p - scale * a * b, b * q + scale * (1.0 - b * b), b * r
    return angle < numbers[8], x * scale, y * scale, u1, u2, u3, v1, v2, v3


@part
def project_brown(numbers, x, y, z):  # type: ignore[no-untyped-def]
    """Image of a direction by Brown's lens without a tilt, as `fisheye`."""
    k1, k2, p1, p2 = numbers[4], numbers[5], numbers[6], numbers[7]
    k3, k4, k5, k6 = numbers[8], numbers[9], numbers[10], numbers[11]
    s1, s2, s3, s4 = numbers[12], numbers[13], numbers[14], numbers[15]
    inverse = 1.0 / z
    u, v = x * inverse, y * inverse
    r2 = u * u + v * v
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
    fall = (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) / below
    du, dv = 2.0 * u, 2.0 * v
    a, b = s1 + 2.0 * r2 * s2, s3 + 2.0 * r2 * s4
    uu = radial + u * fall * du + 2.0 * p1 * v + 6.0 * p2 * u + a * du
    uv = u * fall * dv + 2.0 * p1 * u + 2.0 * p2 * v + a * dv
    vu = v * fall * du + 2.0 * p1 * u + 2.0 * p2 * v + b * du
    vv = radial + v * fall * dv + 6.0 * p1 * v + 2.0 * p2 * u + b * dv
    image_u = u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u) + r2 * (s1 + r2 * s2)
    image_v = v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v + r2 * (s3 + r2 * s4)
    fold = numbers[16]
    seen = z > 0.0 and (fold == math.inf or x * x + y * y < fold * z * (fold * z))
    return (
        seen, image_u, image_v,
        uu * inverse, uv * inverse, -(uu * u + uv * v) * inverse,
        vu * inverse, vv * inverse, -(vu * u + vv * v) * inverse,
    )  # fmt: skip


@part
def project_stereographic(numbers, x, y, z):  # type: ignore[no-untyped-def]
    """Image of a direction in the stereographic chart, as `fisheye`; the chart's basis follows fx … cy."""
    a = numbers[4] * x + numbers[5] * y + numbers[6] * z
    b = numbers[7] * x + numbers[8] * y + numbers[9] * z
    c = numbers[10] * x + numbers[11] * y + numbers[12] * z
    size = math.sqrt(a * a + b * b + c * c)
    total = size + c
    scale = 2.0 / total
    fall = -scale / (total * size)
    ua, ub, uc = scale + a * fall * a, a * fall * b, a * fall * (c + size)
    va, vb, vc = b * fall * a, scale + b * fall * b, b * fall * (c + size)
    return (
        total > numbers[13] * size, a * scale, b * scale,
        ua * numbers[4] + ub * numbers[7] + uc * numbers[10],
        ua * numbers[5] + ub * numbers[8] + uc * numbers[11],
        ua * numbers[6] + ub * numbers[9] + uc * numbers[12],
        va * numbers[4] + vb * numbers[7] + vc * numbers[10],
        va * numbers[5] + vb * numbers[8] + vc * numbers[11],
        va * numbers[6] + vb * numbers[9] + vc * numbers[12],
    )  # fmt: skip


@part
def project_direction(kind, numbers, x, y, z):  # type: ignore[no-untyped-def]
    """Image of a direction by a camera of some kind, as `fisheye`."""
    if kind == KANNALA_BRANDT:
        return project_fisheye(numbers, x, y, z)
    if kind == BROWN:
        return project_brown(numbers, x, y, z)
    if kind == STEREOGRAPHIC:
        return project_stereographic(numbers, x, y, z)
    inverse = 1.0 / z
    u, v = x * inverse, y * inverse
    return z > 0.0, u, v, inverse, 0.0, -u * inverse, 0.0, inverse, -v * inverse


@part
def linearise_one(k, body, poses, views, out):  # type: ignore[no-untyped-def]
    """Images of the points in the k-th of some poses; otherwise as `linearise`."""
    points, normals = body
    rotations, positions = poses
    kinds, numbers, turns, shifts, offsets, sizes, rims = views
    pixels, jacobian, by_position, seen_by, cosine, expected = out
    count = points.shape[0] // kinds.shape[0]
    R, t = rotations[k], positions[k]
    for i in range(points.shape[0]):
        view = i // count
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        # about the centre of the body, as seen from the origin, and from the camera
        r0 = R[0, 0] * a + R[0, 1] * b + R[0, 2] * c
        r1 = R[1, 0] * a + R[1, 1] * b + R[1, 2] * c
        r2 = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c
        p0, p1, p2 = r0 + t[0], r1 + t[1], r2 + t[2]
        Q, s = turns[view], shifts[view]
        x = Q[0, 0] * p0 + Q[0, 1] * p1 + Q[0, 2] * p2 + s[0]
        y = Q[1, 0] * p0 + Q[1, 1] * p1 + Q[1, 2] * p2 + s[1]
        z = Q[2, 0] * p0 + Q[2, 1] * p1 + Q[2, 2] * p2 + s[2]
        own = numbers[view]
        seen, u, v, u1, u2, u3, v1, v2, v3 = project_direction(kinds[view], own, x, y, z)
        u1, u2, u3, v1, v2, v3 = own[0] * u1, own[0] * u2, own[0] * u3, own[1] * v1, own[1] * v2, own[1] * v3
        u, v = own[0] * u + own[2], own[1] * v + own[3]
        total = u + v + u1 + u2 + u3 + v1 + v2 + v3
        if normals.shape[0] > 0:
            m0, m1, m2 = normals[i, 0], normals[i, 1], normals[i, 2]
            n0 = R[0, 0] * m0 + R[0, 1] * m1 + R[0, 2] * m2
            n1 = R[1, 0] * m0 + R[1, 1] * m1 + R[1, 2] * m2
            n2 = R[2, 0] * m0 + R[2, 1] * m1 + R[2, 2] * m2
            f0 = Q[0, 0] * n0 + Q[0, 1] * n1 + Q[0, 2] * n2
            f1 = Q[1, 0] * n0 + Q[1, 1] * n1 + Q[1, 2] * n2
            f2 = Q[2, 0] * n0 + Q[2, 1] * n1 + Q[2, 2] * n2
            length = math.sqrt(m0 * m0 + m1 * m1 + m2 * m2) * math.sqrt(x * x + y * y + z * z)
            cosine[k, i] = -(f0 * x + f1 * y + f2 * z) / length if length > 0.0 else np.nan
        if not (seen and abs(total) < math.inf):
            seen_by[k, i], expected[k, i] = False, 0.0
            for row in range(2):
                pixels[k, i, row] = 0.0
                for column in range(6):
                    jacobian[k, i, row, column] = 0.0
                for column in range(3):
                    by_position[k, i, row, column] = 0.0
            continue
        seen_by[k, i] = True
        width, height = sizes[view, 0], sizes[view, 1]
        inside = min(min(u, width - u), min(v, height - v))
        expected[k, i] = min(max(0.5 + 0.5 * inside / rims[view], 0.0), 1.0) if width < math.inf else 1.0
        pixels[k, i, 0], pixels[k, i, 1] = u + offsets[view, 0], v + offsets[view, 1]
        for row in range(2):
            g0, g1, g2 = (u1, u2, u3) if row == 0 else (v1, v2, v3)
            h0 = g0 * Q[0, 0] + g1 * Q[1, 0] + g2 * Q[2, 0]
            h1 = g0 * Q[0, 1] + g1 * Q[1, 1] + g2 * Q[2, 1]
            h2 = g0 * Q[0, 2] + g1 * Q[1, 2] + g2 * Q[2, 2]
            by_position[k, i, row, 0], by_position[k, i, row, 1], by_position[k, i, row, 2] = h0, h1, h2
            # −a [r]× = r × a
            jacobian[k, i, row, 0] = r1 * h2 - r2 * h1
            jacobian[k, i, row, 1] = r2 * h0 - r0 * h2
            jacobian[k, i, row, 2] = r0 * h1 - r1 * h0
            jacobian[k, i, row, 3], jacobian[k, i, row, 4], jacobian[k, i, row, 5] = h0, h1, h2


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def linearise(body, poses, views, out):  # type: ignore[no-untyped-def]
    """Images of n points by C cameras, to first order; row c n + i is that of point i by camera c.

    Parameters
    ----------
    body : tuple
        Points (C n, 3) about the centre, and their normals, (C n, 3) or (0, 3).
    poses : tuple
        Rotations (K, 3, 3), and positions (K, 3) of the centre.
    views : tuple
        Kinds (C,) of the cameras, their numbers (C, `NUMBERS`), rotations (C, 3, 3) and translations (C, 3) into their
        frames, places (C, 2) of their images in the plane, and sizes (C, 2) of these, infinite where unknown, with
        the width of their soft rims (C,).
    out : tuple
        As `rootmatch.model.linearised.Linearised`: pixels, jacobian, by_position, seen, cosine, expected.
    """
    body, poses, views, out = borrow((body, poses, views, out))
    for k in range(poses[0].shape[0]):
        linearise_one(k, body, poses, views, out)

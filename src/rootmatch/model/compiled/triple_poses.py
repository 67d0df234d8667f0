"""Poses of three points and their rays, compiled; in NumPy: `rootmatch.problems.pose_fit.starts`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import part
from rootmatch.problems.p3p.roots import ratio_pairs


@part
def find_wide_triple(image, target, left_out, out):  # type: ignore[no-untyped-def]
    """A wide triple of the matched points but one, into ``out``; see `starts.triples`."""
    count, u, v = 0, 0.0, 0.0
    for i in range(image.shape[0]):
        if image[i] >= 0 and i != left_out:
            count += 1
            u += target[image[i], 0]
            v += target[image[i], 1]
    u, v = u / max(count, 1), v / max(count, 1)
    for corner in range(2):
        farthest = -1.0
        for i in range(image.shape[0]):
            if image[i] >= 0 and i != left_out:
                distance = (target[image[i], 0] - u) ** 2 + (target[image[i], 1] - v) ** 2
                if distance > farthest:
                    farthest, out[corner] = distance, i
        u, v = target[image[out[0]], 0], target[image[out[0]], 1]
    side_u, side_v = target[image[out[1]], 0] - u, target[image[out[1]], 1] - v
    largest = -1.0
    for i in range(image.shape[0]):
        if image[i] >= 0 and i != left_out and i != out[0] and i != out[1]:
            area = abs((target[image[i], 0] - u) * side_v - (target[image[i], 1] - v) * side_u)
            if area > largest:
                largest, out[2] = area, i
    return count


@part
def fill_triangle_frame(corners, out):  # type: ignore[no-untyped-def]
    """Orthonormal frame of a triangle (3, 3), one corner a row, in the columns of ``out``."""
    ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    out[0, 0], out[1, 0], out[2, 0] = ax, ay, az
    out[0, 1], out[1, 1], out[2, 1] = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    out[0, 2], out[1, 2], out[2, 2] = nx, ny, nz


@part
def solve_triple(points, rays, image, triple, rotations, translations, places, corners, frames):  # type: ignore[no-untyped-def]
    """Four poses that put a triple on its rays; the translation is NaN where there are fewer."""
    side = frames[0, 0]
    versine = frames[0, 1]
    for p in range(3):
        i, j = triple[p], triple[(p + 1) % 3]
        side[p], versine[p] = 0.0, 0.0
        for axis in range(3):
            corners[p, axis] = points[i, axis]
            side[p] += (points[j, axis] - points[i, axis]) ** 2
            versine[p] += 0.5 * (rays[image[j], axis] - rays[image[i], axis]) ** 2
    A, B, C, h = side[0], side[1], side[2], versine[0]
    pairs = ratio_pairs(A, B, C, versine[0], versine[1], versine[2])
    fill_triangle_frame(corners, frames[1])
    for root in range(4):
        x, y = pairs[0], pairs[1]
        if root == 1:
            x, y = pairs[2], pairs[3]
        elif root == 2:
            x, y = pairs[4], pairs[5]
        elif root == 3:
            x, y = pairs[6], pairs[7]
        depth = math.sqrt(A / (1.0 + x * x - 2.0 * (1.0 - h) * x))
        for p in range(3):
            scale = depth if p == 0 else depth * x if p == 1 else depth * y
            for axis in range(3):
                places[p, axis] = scale * rays[image[triple[p]], axis]
        fill_triangle_frame(places, frames[0])
        good = x > 0.0 and y > 0.0
        for p in range(3):
            middle = 0.0
            for q in range(3):
                value = 0.0
                for axis in range(3):
                    value += frames[0, p, axis] * frames[1, q, axis]
                good = good and abs(value) < math.inf
                rotations[root, p, q] = value
                middle += value * (corners[0, q] + corners[1, q] + corners[2, q]) / 3.0
            translations[root, p] = (places[0, p] + places[1, p] + places[2, p]) / 3.0 - middle
        if not good:
            for p in range(3):
                translations[root, p] = np.nan
                for q in range(3):
                    rotations[root, p, q] = 1.0 if p == q else 0.0

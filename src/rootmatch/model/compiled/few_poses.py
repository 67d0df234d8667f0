"""Poses of minimal sets of assignments with few matches, compiled; in NumPy: `rootmatch.problems.pose_fit.starts`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.rotation import SKEW
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.problems.p3p.roots import ratio_pairs


@part
def find_wide_triple(image, target, left_out, out):  # type: ignore[no-untyped-def]
    """A wide triple of the matched points but one, into ``out``; see `starts.wide_triples`."""
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
    """`triangle_frames` of a triangle (3, 3), one corner a row, in the columns of ``out``."""
    ax, ay, az = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    bx, by, bz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    along = nx * ax + ny * ay + nz * az
    if abs(along) > SKEW:
        nx, ny, nz = nx - along * ax, ny - along * ay, nz - along * az
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


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_minimal_poses(points, image, assignments, views, few, out):  # type: ignore[no-untyped-def]
    """Poses of two wide triples of the matches of each assignment in each camera.

    Parameters
    ----------
    points : (C n, 3) array
        About the centre; rows c n to (c + 1) n are sightings by camera c.
    image : tuple
        Detections (n', 2), and their unit rays (n', 3) in the frames of their cameras.
    assignments : (K, C n) int64 array
    views : tuple
        Rotations (C, 3, 3) and translations (C, 3) into the frames of the cameras.
    few : int
        Number of matches in a camera up to which all poses are tried; from three on.
    out : tuple
        Assignment (M,) of each pose, its three points (M, 3), rotations (M, 3, 3) and positions (M, 3), M at least
        8 C K; filled.

    Returns
    -------
    int
        How many poses there are.
    """
    points, image, assignments, views, out = borrow((points, image, assignments, views, out))
    target, rays = image
    turns, shifts = views
    of, members, rotations, positions = out
    cameras, total = turns.shape[0], points.shape[0]
    n, found = total // cameras, 0
    own, triple = np.empty(total, np.int64), np.empty(3, np.int64)
    places, corners, frames = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3, 3))
    turned, moved = np.empty((4, 3, 3)), np.empty((4, 3))
    for camera in range(cameras):
        Q, s = turns[camera], shifts[camera]
        for k in range(assignments.shape[0]):
            count = 0
            for i in range(total):
                own[i] = assignments[k, i] if camera * n <= i < (camera + 1) * n else -1
                count += 1 if own[i] >= 0 else 0
            if count < 3 or count > few:
                continue
            outermost = -1
            # the second triple without the outermost point, should that be a wrong one; of four points it is the first
            for _ in range(2 if count > 4 else 1):
                find_wide_triple(own, target, outermost, triple)
                outermost = triple[0]
                solve_triple(points, rays, own, triple, turned, moved, places, corners, frames)
                for root in range(4):
                    x, y, z = moved[root, 0], moved[root, 1], moved[root, 2]
                    if not abs(x + y + z) < math.inf:
                        continue
                    of[found] = k
                    members[found, 0], members[found, 1], members[found, 2] = triple[0], triple[1], triple[2]
                    for a in range(3):
                        positions[found, a] = Q[0, a] * (x - s[0]) + Q[1, a] * (y - s[1]) + Q[2, a] * (z - s[2])
                        for b in range(3):
                            rotations[found, a, b] = (
                                Q[0, a] * turned[root, 0, b]
                                + Q[1, a] * turned[root, 1, b]
                                + Q[2, a] * turned[root, 2, b]
                            )
                    found += 1
    return found

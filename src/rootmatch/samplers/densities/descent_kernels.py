"""Compiled ascent of poses in the likelihood of an image of densities."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.elimination import solve_damped
from rootmatch.jit.decorators import FASTMATH, driver, part

DAMPING = 1e-3
"""Share of the diagonal that is added to it. A round value."""


@part
def _blur(image, room, taps):  # type: ignore[no-untyped-def]
    """Convolve an image with a symmetric filter along both axes, in place."""
    h, w = image.shape
    middle = taps.size // 2
    for r in range(h):
        for c in range(w):
            room[r, c] = image[r, c] * taps[middle]
        for m in range(1, middle + 1):
            for c in range(m, w):
                room[r, c] += taps[middle + m] * image[r, c - m]
            for c in range(w - m):
                room[r, c] += taps[middle + m] * image[r, c + m]
    for r in range(h):
        for c in range(w):
            image[r, c] = room[r, c] * taps[middle]
        for m in range(1, middle + 1):
            if r >= m:
                for c in range(w):
                    image[r, c] += taps[middle + m] * room[r - m, c]
            if r + m < h:
                for c in range(w):
                    image[r, c] += taps[middle + m] * room[r + m, c]


@part
def _draw_points(points, R, t, origin, cell, seen, place, image):  # type: ignore[no-untyped-def]
    """Project points and share each among the four cells about its image."""
    h, w = image.shape
    image[:] = 0.0
    for i in range(points.shape[0]):
        for a in range(3):
            seen[i, a] = R[a, 0] * points[i, 0] + R[a, 1] * points[i, 1] + R[a, 2] * points[i, 2] + t[a]
        depth = max(seen[i, 2], 1e-9)
        u, v = (seen[i, 0] / depth - origin[0]) / cell, (seen[i, 1] / depth - origin[1]) / cell
        inside = seen[i, 2] > 1e-9 and u >= 0.0 and v >= 0.0 and u < w - 1 and v < h - 1
        place[i, 0], place[i, 1] = (u, v) if inside else (-1.0, -1.0)
        if inside:
            c, r = int(u), int(v)
            u, v = u - c, v - r
            image[r, c] += (1.0 - u) * (1.0 - v)
            image[r, c + 1] += u * (1.0 - v)
            image[r + 1, c] += (1.0 - u) * v
            image[r + 1, c + 1] += u * v


@part
def _gather_normal_equations(ratio, seen, place, t, cell, variance, normal, right):  # type: ignore[no-untyped-def]
    """Normal equations (6, 6) of the step towards the mean detection of each point, rotation about the centre first.

    ``ratio`` is the blurred image of detections over what is expected: at a point it is the weight of its detections,
    and its gradient tells where their mean is.
    """
    normal[:], right[:] = 0.0, 0.0
    for i in range(seen.shape[0]):
        if place[i, 0] < 0.0:
            continue
        c, r = int(place[i, 0]), int(place[i, 1])
        u, v = place[i, 0] - c, place[i, 1] - r
        a, b, d, e = ratio[r, c], ratio[r, c + 1], ratio[r + 1, c], ratio[r + 1, c + 1]
        weight = (a * (1.0 - u) + b * u) * (1.0 - v) + (d * (1.0 - u) + e * u) * v
        along = ((b - a) * (1.0 - v) + (e - d) * v) * variance
        down = ((d - a) * (1.0 - u) + (e - b) * u) * variance
        z = seen[i, 2]
        x, y, scale = seen[i, 0] / z, seen[i, 1] / z, 1.0 / (z * cell)
        p, q, s = seen[i, 0] - t[0], seen[i, 1] - t[1], seen[i, 2] - t[2]
        first = (-x * q * scale, (s + x * p) * scale, -q * scale, scale, 0.0, -x * scale)
        second = ((-s - y * q) * scale, y * p * scale, p * scale, 0.0, scale, -y * scale)
        for k in range(6):
            right[k] += first[k] * along + second[k] * down
            for m in range(6):
                normal[k, m] += weight * (first[k] * first[m] + second[k] * second[m])


@part
def _move_pose(R, t, step, maximum):  # type: ignore[no-untyped-def]
    """Apply a step to a pose in place: at most ``maximum`` radians, and that share of the depth."""
    angle = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    turn = min(angle, maximum)
    sine = np.sin(0.5 * turn) / max(angle, 1e-300)
    w, x, y, z = np.cos(0.5 * turn), step[0] * sine, step[1] * sine, step[2] * sine
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    for b in range(3):
        first, second, third = R[0, b], R[1, b], R[2, b]
        for a in range(3):
            R[a, b] = rows[a][0] * first + rows[a][1] * second + rows[a][2] * third
    t[0] += step[3]
    t[1] += step[4]
    t[2] += min(max(step[5], -maximum * t[2]), maximum * t[2])


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def ascend(points, rotation, position, detections, origin, cell, taps, variance, clutter, steps, likelihood):  # type: ignore[no-untyped-def]
    """Climb from each of K poses, in place, and fill in the log-likelihood (K,) of the detections at the end.

    Parameters
    ----------
    points : (n, 3) array
        From the centre of the body.
    rotation, position : (K, 3, 3), (K, 3) array
        Poses; the position is that of the centre in the camera frame.
    detections : (h, w) array
        How many detections are in each cell of an image in units of the focal length.
    origin, cell : (2,) array, float
        Its first cell, and their size.
    taps, variance : array, float
        Gaussian filter, and its variance in cells².
    clutter : float
        Expected false detections in a cell, for each expected true one of a point.
    steps : int
    likelihood : (K,) array
        Up to a constant that all poses have.
    """
    h, w = detections.shape
    image, room = np.empty((h, w)), np.empty((h, w))
    seen, place = np.empty((points.shape[0], 3)), np.empty((points.shape[0], 2))
    normal, right, work, step = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty(6)
    for k in range(rotation.shape[0]):
        R, t = rotation[k], position[k]
        for turn in range(steps + 1):
            _draw_points(points, R, t, origin, cell, seen, place, image)
            _blur(image, room, taps)
            total = 0.0
            for r in range(h):
                for c in range(w):
                    count = detections[r, c]
                    if count > 0.0:
                        ratio = 1.0 + image[r, c] / clutter
                        total += count * np.log(ratio)
                        image[r, c] = count / (ratio * clutter)
                    else:
                        image[r, c] = 0.0
            likelihood[k] = total
            if turn == steps:
                break
            _blur(image, room, taps)
            _gather_normal_equations(image, seen, place, t, cell, variance, normal, right)
            if not solve_damped(normal, right, DAMPING, 6, work, step):
                break
            _move_pose(R, t, step, 0.3)

"""Damped Gauss-Newton descent of one camera pose without a lens, compiled; see `pinhole_fit`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import part
from rootmatch.problems.pose_fit.base import SETTLED, STEPS


@part
def factored(matrix, size):  # type: ignore[no-untyped-def]
    """Cholesky factor of a symmetric matrix, in place in its lower triangle; log of its determinant.

    What is not positive becomes so small that a step along it is refused.
    """
    logarithm = 0.0
    for j in range(size):
        for i in range(j, size):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[j, j] = math.sqrt(value if value > 1e-300 else 1e-300)
                logarithm += 2.0 * math.log(matrix[j, j])
            else:
                matrix[i, j] = value / matrix[j, j]
    return logarithm


@part
def solved(factor, size, right):  # type: ignore[no-untyped-def]
    """Solve a system by its Cholesky factor, in place in ``right``."""
    for i in range(size):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]


@part
def seen_from(points, image, given, rotation, translation, cut, positions, predicted):  # type: ignore[no-untyped-def]
    """Positions and pixels of all points by a pose; χ² of the matched ones, ∞ where one is behind.

    ``given``: target points, weights and camera. Each point adds at most ``cut``.
    """
    target, weight, camera = given
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    total = 0.0
    for i in range(points.shape[0]):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        x = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c + translation[0]
        y = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c + translation[1]
        z = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c + translation[2]
        u, v = fx * x / z + cx, fy * y / z + cy
        positions[i, 0], positions[i, 1], positions[i, 2] = x, y, z
        predicted[i, 0], predicted[i, 1] = u, v
        k = image[i]
        if k >= 0:
            du, dv = u - target[k, 0], v - target[k, 1]
            squared = (du * du + dv * dv) * weight[k] * weight[k]
            total += squared if squared < cut or not squared >= cut else cut
            if not z > 0.0:
                total = np.inf
    return total if total < np.inf else np.inf


@part
def derivative(position, translation, camera, axes, out):  # type: ignore[no-untyped-def]
    """Derivative (2, p) of a pixel by turns about the axes and by the translation; zero where it is not finite."""
    turns = axes.shape[0]
    x, y, z = position[0], position[1], position[2]
    inverse = 1.0 / z
    a, b = camera[0] * inverse, camera[1] * inverse
    c, d = -a * x * inverse, -b * y * inverse
    px, py, pz = x - translation[0], y - translation[1], z - translation[2]
    for q in range(turns):
        ex, ey, ez = axes[q, 0], axes[q, 1], axes[q, 2]
        mx, my, mz = ey * pz - ez * py, ez * px - ex * pz, ex * py - ey * px
        out[0, q] = a * mx + c * mz
        out[1, q] = b * my + d * mz
    out[0, turns], out[0, turns + 1], out[0, turns + 2] = a, 0.0, c
    out[1, turns], out[1, turns + 1], out[1, turns + 2] = 0.0, b, d
    for row in range(2):
        for q in range(turns + 3):
            if not abs(out[row, q]) < math.inf:
                out[row, q] = 0.0


@part
def equations(image, given, axes, prior, translation, positions, predicted, jacobian, normal, slope):  # type: ignore[no-untyped-def]
    """Normal equations of the matched points, without the prior's slope."""
    target, weight, camera = given
    size = prior.shape[0]
    for p in range(size):
        slope[p] = 0.0
        for q in range(size):
            normal[p, q] = prior[p] if p == q else 0.0
    for i in range(image.shape[0]):
        k = image[i]
        if k < 0:
            continue
        derivative(positions[i], translation, camera, axes, jacobian)
        w2 = weight[k] * weight[k]
        for row in range(2):
            residual = predicted[i, row] - target[k, row]
            residual = residual if abs(residual) < math.inf else 0.0
            for p in range(size):
                scaled = w2 * jacobian[row, p]
                slope[p] += scaled * residual
                for q in range(p + 1):
                    normal[p, q] += scaled * jacobian[row, q]
    for p in range(size):
        for q in range(p):
            normal[q, p] = normal[p, q]


@part
def turned(step, axes, rotation, out):  # type: ignore[no-untyped-def]
    """A rotation followed by the turn of a step about the axes (Rodrigues)."""
    x, y, z = 0.0, 0.0, 0.0
    for q in range(axes.shape[0]):
        x += step[q] * axes[q, 0]
        y += step[q] * axes[q, 1]
        z += step[q] * axes[q, 2]
    angle = math.sqrt(x * x + y * y + z * z)
    half = 0.5 * angle
    first = math.sin(angle) / angle if angle > 0.0 else 1.0
    second = math.sin(half) / half if angle > 0.0 else 1.0
    second = 0.5 * second * second
    for q in range(3):
        a, b, c = rotation[0, q], rotation[1, q], rotation[2, q]
        u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
        out[0, q] = a + first * u + second * (y * w - z * v)
        out[1, q] = b + first * v + second * (z * u - x * w)
        out[2, q] = c + first * w + second * (x * v - y * u)


@part
def copied(rotation, translation, new_rotation, new_translation):  # type: ignore[no-untyped-def]
    """Copy a pose into another.

    Entry by entry: for what assigns a slice, Numba also compiles the words of an error about its shape, for seconds.
    """
    for p in range(3):
        new_translation[p] = translation[p]
        for q in range(3):
            new_rotation[p, q] = rotation[p, q]


@part
def descended(points, image, given, axes, prior, rotation, translation, scratch):  # type: ignore[no-untyped-def]
    """Refine a pose in place by damped Gauss-Newton; its χ², that of the prior included.

    Every pose is judged by the one call of `seen_from`: each called function is copied into its caller, and optimised.
    """
    positions, predicted, jacobian, normal, factor, slope, step, tilt, new, moved = scratch
    size, turns = prior.shape[0], axes.shape[0]
    if not abs(translation[0]) + abs(translation[1]) + abs(translation[2]) < math.inf:
        translation[0], translation[1], translation[2] = 0.0, 0.0, 5.0
    copied(rotation, translation, new, moved)
    for p in range(size):
        tilt[p], step[p] = 0.0, 0.0
    damping, chi2 = 1e-6, np.inf
    for trial in range(STEPS + 1):
        value = seen_from(points, image, given, new, moved, np.inf, positions, predicted)
        for p in range(size):
            value += (tilt[p] + step[p]) ** 2 * prior[p]
        if trial > 0 and not value <= chi2:
            damping = 30.0 * max(damping, 1e-4)
        else:
            fall = chi2 - value if value < np.inf else 0.0
            chi2 = value
            copied(new, moved, rotation, translation)
            for p in range(size):
                tilt[p] += step[p]
            if trial > 0:
                damping *= 0.1
                # what is behind the camera may still come before it
                if chi2 < np.inf and not fall > SETTLED * (1.0 + chi2):
                    break
            equations(image, given, axes, prior, translation, positions, predicted, jacobian, normal, slope)
            for p in range(size):
                slope[p] += tilt[p] * prior[p]
        if trial == STEPS:
            break
        for p in range(size):
            step[p] = slope[p]
            for q in range(size):
                factor[p, q] = normal[p, q]
            factor[p, p] = normal[p, p] * (1.0 + damping) + 1e-300
        factored(factor, size)
        solved(factor, size, step)
        for p in range(size):
            step[p] = -step[p]
        turned(step, axes, rotation, new)
        for p in range(3):
            moved[p] = translation[p] + step[turns + p]
    return chi2

"""Poses with their depth reversed, compiled: see `rootmatch.model.proposals`."""

from __future__ import annotations

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.eigenvectors import diagonalise


@part
def least_axis(matrix, axes, out):  # type: ignore[no-untyped-def]
    """Unit eigenvector (3,) of the least eigenvalue of a symmetric matrix (3, 3), which becomes diagonal.

    ``axes`` (3, 3): scratch.
    """
    diagonalise(matrix, axes)
    minimum = 0
    for i in range(1, 3):
        minimum = i if matrix[i, i] < matrix[minimum, minimum] else minimum
    for i in range(3):
        out[i] = axes[i, minimum]


@part
def fit_plane(points, assignment, scratch, centre, normal):  # type: ignore[no-untyped-def]
    """Centre (3,) and normal (3,) of the plane nearest to the matched points: `starts.fit_planes`, compiled."""
    scatter, axes = scratch
    count = 0
    for p in range(3):
        centre[p] = 0.0
        for q in range(3):
            scatter[p, q] = 0.0
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0:
            count += 1
            for p in range(3):
                centre[p] += points[i, p]
    for p in range(3):
        centre[p] /= max(count, 1)
    for i in range(assignment.shape[0]):
        if assignment[i] >= 0:
            for p in range(3):
                for q in range(3):
                    scatter[p, q] += (points[i, p] - centre[p]) * (points[i, q] - centre[q]) / count
    least_axis(scatter, axes, normal)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def reverse_depth(assignments, points, poses, views, out):  # type: ignore[no-untyped-def]
    """Poses that look alike from the camera with most matches; in NumPy and of one camera: `starts.reflect_poses`.

    Parameters
    ----------
    assignments : (K, C n) int64 array
        Columns c n to (c + 1) n are sightings by camera c.
    points : (C n, 3) array
        About the centre of the body.
    poses : tuple
        Rotations (K, 3, 3), and positions (K, 3) of the centre.
    views : tuple
        Rotations (C, 3, 3) and translations (C, 3) into the frames of the cameras.
    out : tuple
        Such poses, filled.
    """
    assignments, points, poses, views, out = borrow((assignments, points, poses, views, out))
    rotations, positions = poses
    turns, shifts = views
    turned, moved = out
    n = assignments.shape[1] // turns.shape[0]
    half, sight, eye = np.empty((3, 3)), np.empty(3), np.empty(3)
    centre, normal, scratch = np.empty(3), np.empty(3), (np.empty((3, 3)), np.empty((3, 3)))
    for k in range(rotations.shape[0]):
        fit_plane(points, assignments[k], scratch, centre, normal)
        maximum, camera = -1, 0
        for view in range(turns.shape[0]):
            matches = 0
            for i in range(view * n, (view + 1) * n):
                matches += 1 if assignments[k, i] >= 0 else 0
            if matches > maximum:
                maximum, camera = matches, view
        length = 0.0
        for p in range(3):
            eye[p], middle = 0.0, positions[k, p]
            for q in range(3):
                eye[p] -= turns[camera, q, p] * shifts[camera, q]
                middle += rotations[k, p, q] * centre[q]
            sight[p] = middle - eye[p]
            length += sight[p] * sight[p]
        length = max(length, 1e-300)
        for p in range(3):  # R (1 − 2 m mᵀ)
            along = 0.0
            for q in range(3):
                along += rotations[k, p, q] * normal[q]
            for q in range(3):
                half[p, q] = rotations[k, p, q] - 2.0 * along * normal[q]
        for q in range(3):  # (1 − 2 s sᵀ) of that
            along = 2.0 * (sight[0] * half[0, q] + sight[1] * half[1, q] + sight[2] * half[2, q]) / length
            for p in range(3):
                turned[k, p, q] = half[p, q] - along * sight[p]
        for p in range(3):
            place = sight[p] + eye[p]
            for q in range(3):
                place -= turned[k, p, q] * centre[q]
            moved[k, p] = place

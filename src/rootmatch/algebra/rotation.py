"""Rotation matrices for NumPy: from rotation vectors, about the y axis, onto it, random ones, and a grid."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Floats

SKEW = 1e-6
"""Cosine between the normal of a triangle and its side from which that normal is a rounding error: its corners are on a
line but for some 1e-10 of their distance. A round value."""


def cross(first: Floats, second: Floats) -> Floats:
    """Cross products (…, 3) of vectors (…, 3), for few of them a fifth of the time of `numpy.cross`."""
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    x, y, z = second[..., 0], second[..., 1], second[..., 2]
    out = np.empty(np.broadcast_shapes(first.shape, second.shape))
    out[..., 0] = b * z - c * y
    out[..., 1] = c * x - a * z
    out[..., 2] = a * y - b * x
    return out


def cross_matrix(vectors: Floats) -> Floats:
    """Matrices (…, 3, 3) of the cross products with vectors (…, 3): ``cross_matrix(a) @ b`` is a × b."""
    out = np.zeros((*vectors.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -vectors[..., 2], vectors[..., 1], -vectors[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = vectors[..., 2], -vectors[..., 1], vectors[..., 0]
    return out


def triangle_frames(corners: Floats) -> Floats:
    """Right-handed orthonormal frames (…, 3, 3) of triangles (…, 3, 3), as columns; NaN where the corners are in line.

    The first column lies along a side, the last across the plane: across the line alone where that is a rounding error.
    """
    with np.errstate(invalid="ignore"):
        first = corners[..., 1, :] - corners[..., 0, :]
        first = first / np.linalg.norm(first, axis=-1, keepdims=True)
        normal = cross(first, corners[..., 2, :] - corners[..., 0, :])
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        along = (normal * first).sum(axis=-1, keepdims=True)
        if (np.abs(along) > SKEW).any():
            across = normal - along * first
            across = across / np.linalg.norm(across, axis=-1, keepdims=True)
            normal = np.where(np.abs(along) > SKEW, across, normal)
        return np.stack([first, cross(normal, first), normal], axis=-1)


def angle_count(dimension: int) -> int:
    """Number of angles of a rotation: one in a plane, three in space."""
    return 3 if dimension == 3 else 1


def turn_jacobian(points: Floats) -> Floats:
    """Derivative (…, k, angles) of turned points (…, k) by the turn, which is small: ω × x, one angle in a plane."""
    if points.shape[-1] == 2:
        return np.stack([-points[..., 1], points[..., 0]], axis=-1)[..., None]
    return -cross_matrix(points)


def rotation_from_vector(vectors: Floats) -> Floats:
    """Rotation matrices (K, 3, 3) of rotation vectors (K, 3), whose length is the angle in radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[:, None, None]
    cross = cross_matrix(vectors)
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * cross @ cross
    )


def rotation_vector(rotation: Floats) -> Floats:
    """Rotation vectors (K, 3) of rotation matrices (K, 3, 3); one of the two for a half turn."""
    axis = np.empty((len(rotation), 3))
    for k, (row, column) in enumerate(((2, 1), (0, 2), (1, 0))):
        axis[:, k] = 0.5 * (rotation[:, row, column] - rotation[:, column, row])
    sine = np.sqrt((axis**2).sum(axis=1))
    cosine = 0.5 * (rotation[:, 0, 0] + rotation[:, 1, 1] + rotation[:, 2, 2] - 1.0)
    small = sine < 1e-9
    ratio = np.where(small, 1.0, np.arctan2(sine, cosine) / np.where(small, 1.0, sine))
    vectors = axis * ratio[:, None]
    (half,) = np.nonzero(small & (cosine < 0.0))
    if len(half):  # R = 2 n nᵀ − I, whose longest column tells n
        columns = rotation[half] + np.eye(3)
        longest = np.diagonal(columns, axis1=1, axis2=2).argmax(axis=1)
        about = columns[np.arange(len(half)), :, longest]
        vectors[half] = np.pi * about / np.linalg.norm(about, axis=1, keepdims=True)
    return np.asarray(vectors)


def move_along_arc(vector: Floats, along: Floats) -> Floats:
    """Where motions (…, 3) of a body lead that turns by rotation vectors (…, 3) meanwhile, both at constant rates."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    once = cross(vector, along)
    twice, half = cross(vector, once), np.sinc(0.5 * angle / np.pi)
    third = (1.0 - np.sinc(angle / np.pi)) / np.maximum(angle, 1e-4) ** 2
    return np.asarray(along + 0.5 * half**2 * once + third * twice)


def arc_motion(vector: Floats, moved: Floats) -> Floats:
    """The inverse of `move_along_arc`: the motions (…, 3) that lead a body to where it has moved (…, 3)."""
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    once = cross(vector, moved)
    bent = np.where(
        half > 1e-3, (1.0 - half / np.tan(np.maximum(half, 1e-3))) / np.maximum(2.0 * half, 1e-3) ** 2, 1.0 / 12.0
    )
    return np.asarray(moved - 0.5 * once + bent * cross(vector, once))


def left_turn_jacobian(vector: Floats) -> Floats:
    """Derivatives (…, 3, 3) of rotation vectors (…, 3) by a small rotation that follows."""
    return np.moveaxis(arc_motion(vector[..., None, :], np.eye(3)), -1, -2)


def rotation_about_y(cosine: Floats, sine: Floats) -> Floats:
    """Rotation matrices (…, 3, 3) about the y axis by angles with these cosines and sines (…)."""
    out = np.zeros((*cosine.shape, 3, 3))
    out[..., 0, 0] = out[..., 2, 2] = cosine
    out[..., 0, 2], out[..., 1, 1] = sine, 1.0
    out[..., 2, 0] = -out[..., 0, 2]
    return out


def rotation_onto_y(direction: Floats) -> Floats:
    """The smallest rotation (3, 3) that takes a unit vector onto (0, 1, 0); by 180° about x for (0, −1, 0)."""
    x, cosine, z = direction
    sine2 = x * x + z * z
    if cosine < 0.0 and sine2 == 0.0:
        return np.diag([1.0, -1.0, -1.0])
    cross = cross_matrix(np.array([-z, 0.0, x]))  # of direction × y
    # 1 / (1 + cos); near −y that sum cancels, so there it is (1 − cos) / sin²
    factor = 1.0 / (1.0 + cosine) if cosine > 0.0 else (1.0 - cosine) / sine2
    rotation: Floats = np.eye(3) + cross + factor * cross @ cross
    return rotation


def random_rotation(rng: np.random.Generator) -> Floats:
    """Rotation uniform over SO(3): a unit quaternion uniform on the 3-sphere."""
    from scipy.spatial.transform import Rotation

    q = rng.standard_normal(4)
    return np.asarray(Rotation.from_quat(q / np.linalg.norm(q)).as_matrix())


def one_rotation_matrix(vector: Floats) -> Floats:
    """Rotation matrix (3, 3) of one rotation vector (3,), in a tenth of the time of `rotation_from_vector`."""
    x, y, z = vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    s, c = (math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)) if angle > 1e-6 else (1.0, 0.5)
    return np.array(
        [
            [1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)],
        ]
    )


def one_rotation_vector(R: Floats) -> Floats:
    """Rotation vector (3,) of one rotation matrix (3, 3), in less time than `rotation_vector`; exact below 180°."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    x, y, z = 0.5 * (h - f), 0.5 * (c - g), 0.5 * (d - b)
    sine = math.sqrt(x * x + y * y + z * z)
    ratio = math.atan2(sine, 0.5 * (a + e + i - 1.0)) / sine if sine > 1e-12 else 1.0
    return np.array([ratio * x, ratio * y, ratio * z])


def spread_rotations(count: int) -> Floats:
    """Rotations (count, 3, 3) that are spread evenly: a super-Fibonacci spiral of quaternions (Alexa, CVPR 2022)."""
    t = np.arange(count) + 0.5
    first, second = 2.0 * np.pi * t / math.sqrt(2.0), 2.0 * np.pi * t / 1.533751168755204288118041
    low, high = np.sqrt(t / count), np.sqrt(1.0 - t / count)
    x, y, z, w = low * np.sin(first), low * np.cos(first), high * np.sin(second), high * np.cos(second)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)

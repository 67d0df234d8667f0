"""Camera poses of whole assignments for a camera without a lens, compiled: what `absolute` does in NumPy.

The same starts, the same damped Gauss-Newton descent and the same results, to rounding and to the last step of a
descent, in a small fraction of the time: a small match spent a quarter of it on one or two fits.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.jit.decorators import driver
from rootmatch.problems.pose_fit.pinhole_descent import (
    copied,
    derivative,
    descended,
    equations,
    factored,
    seen_from,
    solved,
)
from rootmatch.problems.pose_fit.pinhole_starts import start_of_triple, start_upright, wide_triple

Floats = NDArray[np.float64]

CUT = 100.0
"""Squared deviation at which a point stops counting when starts are compared; see `absolute`."""
STARTS = 8
"""Most solutions of two triples."""


class FittedPoses(NamedTuple):
    """K poses and what follows from them; see `absolute.AbsoluteFit`."""

    rotation: Floats
    """(K, 3, 3)."""
    translation: Floats
    """(K, 3)."""
    chi2: Floats
    """(K,) sum of squares, that of the prior included."""
    covariance: Floats
    """(K, p, p)."""
    positions: Floats
    """(K, n, 3)."""
    predicted: Floats
    """(K, n, 2)."""
    jacobian: Floats
    """(K, n, 2, p)."""
    evidence: Floats
    """(K,)."""
    dof: NDArray[np.int64]
    """(K,)."""
    seen: NDArray[np.bool_]
    """(K, n)."""


class Vertical(NamedTuple):
    """A known vertical: points and rays in frames of which it is the y axis, and the rotations into these."""

    points: Floats
    """(n, 3)."""
    rays: Floats
    """(n', 3)."""
    world: Floats
    """(3, 3)."""
    camera: Floats
    """(3, 3)."""


def fitted_poses(
    points: Floats,
    rays: Floats,
    target: Floats,
    weight: Floats,
    camera: Floats,
    axes: Floats,
    prior: Floats,
    vertical: Vertical | None,
    assignments: NDArray[np.int64],
) -> FittedPoses:
    """The best pose of each assignment.

    Parameters
    ----------
    points : (n, 3) array
    rays : (n', 3) array
        Unit bearings.
    target : (n', 2) array
    weight : (n',) array
        One over the standard deviation of a pixel coordinate.
    camera : (4,) array
        Focal lengths and principal point.
    axes : (a, 3) array
        Of the camera frame, about which a pose turns.
    prior : (a + 3,) array
        Inverse variances of turns and translation.
    vertical : Vertical, optional
        Neither case is compiled for the other.
    assignments : (K, n) int64 array
        −1 where unmatched; at least three matches in each.
    """
    count, n, size = len(assignments), len(points), len(prior)
    out = FittedPoses(
        rotation=np.empty((count, 3, 3)),
        translation=np.empty((count, 3)),
        chi2=np.empty(count),
        covariance=np.empty((count, size, size)),
        positions=np.empty((count, n, 3)),
        predicted=np.empty((count, n, 2)),
        jacobian=np.empty((count, n, 2, size)),
        evidence=np.empty(count),
        dof=np.empty(count, np.int64),
        seen=np.empty((count, n), np.bool_),
    )
    _fit(points, rays, target, weight, camera, axes, prior, vertical, assignments, out)
    return out


@driver(nogil=True, error_model="numpy")
def _fit(points, rays, target, weight, camera, axes, prior, vertical, assignments, out):  # type: ignore[no-untyped-def]
    """Fill in the poses of all assignments."""
    n, size = points.shape[0], prior.shape[0]
    positions, predicted, jacobian = np.empty((n, 3)), np.empty((n, 2)), np.empty((2, size))
    normal, factor = np.empty((size, size)), np.empty((size, size))
    slope, step, tilt = np.empty(size), np.empty(size), np.empty(size)
    new, moved, linear = np.empty((3, 3)), np.empty(3), np.empty((8, 6))
    rotations, translations, triple = np.empty((STARTS, 3, 3)), np.empty((STARTS, 3)), np.empty(3, np.int64)
    places, corners, frames = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3, 3))
    scratch = positions, predicted, jacobian, normal, factor, slope, step, tilt, new, moved
    given = target, weight, camera
    for row in range(assignments.shape[0]):
        image = assignments[row]
        first, second, descents = 0, 1, 2
        if vertical is not None:
            descents = 1
            start_upright(
                image, weight, vertical.points, vertical.rays, vertical.world, vertical.camera,
                rotations[0], translations[0], linear,
            )  # fmt: skip
        else:
            left_out: Any = np.int64(-1)  # of the type it will have, or what it is given to would be compiled for both
            for half in range(2):
                count = wide_triple(image, target, left_out, triple)
                start_of_triple(
                    points, rays, image, triple, rotations[4 * half : 4 * half + 4],
                    translations[4 * half : 4 * half + 4], places, corners, frames,
                )  # fmt: skip
                # the second without the outermost point, should that be a wrong one
                left_out = triple[0] if count > 4 else -1
            least, next_least = np.inf, np.inf
            for start in range(STARTS):
                total = seen_from(
                    points, image, given, rotations[start], translations[start], CUT, positions, predicted
                )
                if total < least:
                    first, second, least, next_least = start, first, total, least
                elif total < next_least:
                    second, next_least = start, total
        chi2, best = np.inf, first
        # two, which near a plane nearly coincide
        for descent in range(descents):
            start = first if descent == 0 else second
            value = descended(points, image, given, axes, prior, rotations[start], translations[start], scratch)
            if descent == 0 or value < chi2:
                chi2, best = value, start
        rotation, translation = out.rotation[row], out.translation[row]
        copied(rotations[best], translations[best], rotation, translation)
        out.chi2[row] = chi2
        seen_from(points, image, given, rotation, translation, np.inf, out.positions[row], out.predicted[row])
        equations(
            image, given, axes, prior, translation, out.positions[row], out.predicted[row], jacobian, normal, slope
        )
        for i in range(n):
            derivative(out.positions[row, i], translation, camera, axes, out.jacobian[row, i])
        for p in range(size):
            normal[p, p] = normal[p, p] * (1.0 + 1e-12) + 1e-300
        out.evidence[row] = -0.5 * (chi2 + factored(normal, size))
        out.dof[row] = -6
        if vertical is not None:
            out.dof[row] = -4
        for i in range(n):
            out.seen[row, i] = out.positions[row, i, 2] > 0.0
            if image[i] >= 0:
                out.evidence[row] -= math.log(2.0 * math.pi) - 2.0 * math.log(weight[image[i]])
                out.dof[row] += 2
        for p in range(size):
            for q in range(size):
                slope[q] = 1.0 if p == q else 0.0
            solved(normal, size, slope)
            for q in range(size):
                out.covariance[row, p, q] = slope[q]

"""Poses of minimal sets of assignments with few matches, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver
from rootmatch.model.compiled.triple_poses import find_wide_triple, solve_triple


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

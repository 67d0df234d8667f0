"""SoftPOSIT (David, DeMenthon, Duraiswami and Samet, IJCV 2004), restated from the article as a baseline.

Pose and correspondence are found in turn: softassign turns distances between scaled image points and the projected
model into a doubly stochastic matrix with slack for outliers, and POSIT's scaled orthographic pose follows from all
pairs, each with its weight. The inverse temperature β grows from start to end. The result is a local optimum, so it is
begun from many rotations.
"""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats

FIRST_BETA, LAST_BETA, GROWTH = 4e-4, 0.5, 1.05
"""The article's annealing."""
SINKHORN = 30
"""Most alternations of rows and columns; the article iterates until they settle."""
SETTLED = 1e-3


def softposit(
    points: Floats, image: Floats, focal: float, noise: float, *, start: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """The pose to which one start leads.

    Parameters
    ----------
    points : (n, 3) array
    image : (n', 2) array
        Pixels, less the principal point.
    focal, noise : float
        In pixels.
    start : (3, 3), (3,) array
        Rotation and translation.
    """
    R, t = start
    homogeneous = np.column_stack([points, np.ones(len(points))])
    x = image / focal
    reach = 9.21 * noise**2 + 1.0  # squared distance at which a pair and no pair are equally good
    first, second, w = _scaled_rows(R, t, points)
    beta = FIRST_BETA
    while beta < LAST_BETA:
        u, v = homogeneous @ first, homogeneous @ second
        distance = focal**2 * ((u - np.outer(x[:, 0], w)) ** 2 + (v - np.outer(x[:, 1], w)) ** 2)
        pairs = _softassign(np.exp(-np.minimum(beta * (distance - reach), 500.0)))
        weight = pairs.sum(axis=0)
        moments = (homogeneous.T * weight) @ homogeneous
        if np.linalg.cond(moments) > 1e12:
            break
        first = np.linalg.solve(moments, homogeneous.T @ (w * (x[:, 0] @ pairs)))
        second = np.linalg.solve(moments, homogeneous.T @ (w * (x[:, 1] @ pairs)))
        if not min(np.linalg.norm(first[:3]), np.linalg.norm(second[:3])) > 0.0:
            break  # the detections that are left are all at the principal point: the body is infinitely far
        R, t = _pose_of_rows(first, second)
        first, second, w = _scaled_rows(R, t, points)
        beta *= GROWTH
    return R, t


def _scaled_rows(R: Floats, t: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """The two rows of the scaled orthographic pose, and how each point's depth departs from that of the origin."""
    return np.append(R[0], t[0]) / t[2], np.append(R[1], t[1]) / t[2], points @ R[2] / t[2] + 1.0


def _pose_of_rows(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """The nearest rotation and the translation of two rows."""
    scale = np.sqrt(np.linalg.norm(first[:3]) * np.linalg.norm(second[:3]))
    left, _, right = np.linalg.svd(np.stack([first[:3], second[:3]]), full_matrices=False)
    rows = left @ right
    R = np.vstack([rows, np.cross(rows[0], rows[1])])
    return R, np.array([first[3], second[3], 1.0]) / scale


def _softassign(weights: Floats) -> Floats:
    """Weights (n', n) with rows and columns that sum to 1 with those of a slack line each."""
    whole = np.ones((weights.shape[0] + 1, weights.shape[1] + 1))
    whole[:-1, :-1] = weights
    for _ in range(SINKHORN):
        before = whole[:-1, :-1].copy()
        whole[:-1] /= whole[:-1].sum(axis=1, keepdims=True)
        whole[:, :-1] /= whole[:, :-1].sum(axis=0, keepdims=True)
        if np.abs(whole[:-1, :-1] - before).max() < SETTLED:
            break
    return whole[:-1, :-1]

"""The joint residual of lists of P3P hyper-edges, many side by side.

`joint_residual` computes it for one hyper-edge, in branches that no vector follows. Here the inputs of each are
gathered into the columns of a block, and every root of every column is evaluated, whether it exists or not: that takes
a fifth of the time.
"""

from __future__ import annotations

import numpy as np

from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.p3p.prediction import (
    camera_frame,
    facing_away,
    is_triple_visible,
    prediction,
    source_frame,
    squared_deviation,
)
from rootmatch.problems.p3p.roots import ratio_pairs

# not plain integers, for each of which Numba would compile what takes them anew
DISTANCES, ANGLES, POINTS, NORMALS, RAYS, VARIANCES, MINIMUM = np.array([8, 11, 14, 26, 42, 54, 58])
"""First rows of the block's parts, after the roots: |ab|², |bc|², |ca|²; versines; three for each of a, b, c, d
(four for normals); …"""


@scalar
def three_rows(block, row, k):  # type: ignore[no-untyped-def]
    """Entries of a column in three rows that follow each other."""
    return block[row, k], block[row + 1, k], block[row + 2, k]


@scalar
def four_rows(block, row, k):  # type: ignore[no-untyped-def]
    """Entries of a column in four rows that follow each other."""
    return block[row, k], block[row + 1, k], block[row + 2, k], block[row + 3, k]


@kernel
def gather(t, source, target, first, last, block):  # type: ignore[no-untyped-def]
    """Gather the inputs of hyper-edges first … last − 1; columns beyond repeat the last."""
    s, h = t.distance2, t.versine
    for k in range(block.shape[1]):
        e = min(first + k, last - 1)
        for p in range(3):
            q = p + 1 if p < 2 else 0
            block[DISTANCES + p, k] = s[source[e, p], source[e, q]]
            block[ANGLES + p, k] = h[target[e, p], target[e, q]]
        for p in range(4):
            a, b = source[e, p], target[e, p]
            for axis in range(3):
                block[POINTS + 3 * p + axis, k] = t.points[axis, a]
                block[RAYS + 3 * p + axis, k] = t.rays[axis, b]
            for axis in range(4):
                block[NORMALS + 4 * p + axis, k] = t.normals[axis, a]
            block[VARIANCES + p, k] = t.variance[b]


@scalar
def squared_residual_at(x, y, block, k):  # type: ignore[no-untyped-def]
    """Square of a column's residual at one root; UNINFORMATIVE² without a solution or where a point faces away."""
    rays = three_rows(block, RAYS, k), three_rows(block, RAYS + 3, k), three_rows(block, RAYS + 6, k)
    normals = four_rows(block, NORMALS, k), four_rows(block, NORMALS + 4, k), four_rows(block, NORMALS + 8, k)
    source = source_frame(
        three_rows(block, POINTS, k), three_rows(block, POINTS + 3, k), three_rows(block, POINTS + 6, k)
    )
    frame = camera_frame(block[DISTANCES, k], block[ANGLES, k], x, y, rays)
    predicted = prediction(source, frame, rays, three_rows(block, VARIANCES, k), three_rows(block, POINTS + 9, k))
    chi2 = squared_deviation(predicted, three_rows(block, RAYS + 9, k), block[VARIANCES + 3, k])
    away = facing_away(source, frame, four_rows(block, NORMALS + 12, k), predicted[0])
    visible = is_triple_visible(source, frame, normals, rays) & (away <= 0.0)
    return chi2 if (x > 0.0) & (y > 0.0) & visible else UNINFORMATIVE * UNINFORMATIVE


@kernel
def fill_block(t, kind, source, target, first, last, block):  # type: ignore[no-untyped-def]
    """Squares of the residuals of many hyper-edges at once, into the last part of the block."""
    gather(t, source, target, first, last, block)
    for k in range(block.shape[1]):
        A, B, C = three_rows(block, DISTANCES, k)
        hab, hbc, hca = three_rows(block, ANGLES, k)
        (
            block[0, k], block[1, k], block[2, k], block[3, k], block[4, k], block[5, k], block[6, k], block[7, k],
        ) = ratio_pairs(A, B, C, hab, hbc, hca)  # fmt: skip
        block[MINIMUM, k] = UNINFORMATIVE * UNINFORMATIVE
    for root in range(4):
        for k in range(block.shape[1]):
            chi2 = squared_residual_at(block[2 * root, k], block[2 * root + 1, k], block, k)
            block[MINIMUM, k] = min(block[MINIMUM, k], chi2)


@kernel
def listed(t, kind, i, j, block, k):  # type: ignore[no-untyped-def]
    """Kernel of one hyper-edge of the list: its residual from the block."""
    return np.sqrt(block[MINIMUM, k])

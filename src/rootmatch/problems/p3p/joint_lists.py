"""The joint residual of lists of P3P hyper-edges, many side by side.

`rootmatch.problems.p3p.joint` has the same for one hyper-edge, in branches that no vector follows. Here what the tables
say of each is gathered into the columns of a block, and all roots of all columns are looked at, those that are not
there too: a fifth of the time.
"""

from __future__ import annotations

import numpy as np

from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.p3p.joint import (
    affine_coordinates,
    affine_of,
    backward,
    mahalanobis2,
    predict,
    solution_frame,
)
from rootmatch.problems.p3p.resultant import LARGE
from rootmatch.problems.p3p.roots import ratio_pairs

# not plain integers, for each of which Numba would compile what takes them anew
DISTANCES, ANGLES, POINTS, NORMALS, RAYS, VARIANCES, LEAST = np.array([8, 11, 14, 26, 38, 50, 54])
"""First rows of the block's parts, after the roots: |ab|², |bc|², |ca|²; versines; three for each of a, b, c, d; …"""


@scalar
def three(block, row, k):  # type: ignore[no-untyped-def]
    """Three rows of a column."""
    return block[row, k], block[row + 1, k], block[row + 2, k]


@kernel
def gather(t, source, target, first, last, block):  # type: ignore[no-untyped-def]
    """What the residuals of hyper-edges first … last − 1 are made of; columns beyond repeat the last."""
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
                block[NORMALS + 3 * p + axis, k] = t.normals[axis, a]
                block[RAYS + 3 * p + axis, k] = t.rays[axis, b]
            block[VARIANCES + p, k] = t.variance[b]


@scalar
def squared_at(x, y, block, k):  # type: ignore[no-untyped-def]
    """Square of the residual of a column at one root; LARGE² where it is not there or a point would look away."""
    ax, ay, az = three(block, RAYS, k)
    bx, by, bz = three(block, RAYS + 3, k)
    cx, cy, cz = three(block, RAYS + 6, k)
    dx, dy, dz = three(block, RAYS + 9, k)
    affine = affine_of(three(block, POINTS, k), three(block, POINTS + 3, k), three(block, POINTS + 6, k))
    frame = solution_frame(block[DISTANCES, k], x, y, block[ANGLES, k], ax, ay, az, bx, by, bz, cx, cy, cz)
    px, py, pz = three(block, POINTS + 9, k)
    alpha, beta, gamma = affine_coordinates(affine, px, py, pz)
    d0, d1, d2, d3, d4, d5, d6, d7, d8, d9, d10, d11 = predict(
        alpha, beta, gamma, frame, ax, ay, az, bx, by, bz, cx, cy, cz,
        block[VARIANCES, k], block[VARIANCES + 1, k], block[VARIANCES + 2, k],
    )  # fmt: skip
    v = block[VARIANCES + 3, k]
    chi2 = mahalanobis2(d0, d1, d2, d3, d4, d5, d6, d7, d8, d9, d10, d11, dx, dy, dz, v)
    back = backward(affine, frame, three(block, NORMALS, k), ax, ay, az)
    back = max(back, backward(affine, frame, three(block, NORMALS + 3, k), bx, by, bz))
    back = max(back, backward(affine, frame, three(block, NORMALS + 6, k), cx, cy, cz))
    back = max(back, backward(affine, frame, three(block, NORMALS + 9, k), d0, d1, d2))
    return chi2 if (x > 0.0) & (y > 0.0) & (back <= 0.0) else LARGE * LARGE


@kernel
def block_joint(t, kind, source, target, first, last, block):  # type: ignore[no-untyped-def]
    """Squares of the residuals of many hyper-edges at once, into the last part of the block."""
    gather(t, source, target, first, last, block)
    for k in range(block.shape[1]):
        A, B, C = three(block, DISTANCES, k)
        hab, hbc, hca = three(block, ANGLES, k)
        (
            block[0, k], block[1, k], block[2, k], block[3, k], block[4, k], block[5, k], block[6, k], block[7, k],
        ) = ratio_pairs(A, B, C, hab, hbc, hca)  # fmt: skip
        block[LEAST, k] = LARGE * LARGE
    for root in range(4):
        for k in range(block.shape[1]):
            chi2 = squared_at(block[2 * root, k], block[2 * root + 1, k], block, k)
            block[LEAST, k] = min(block[LEAST, k], chi2)


@kernel
def listed_joint(t, kind, i, j, block, k):  # type: ignore[no-untyped-def]
    """What the block says of one of them."""
    return np.sqrt(block[LEAST, k])

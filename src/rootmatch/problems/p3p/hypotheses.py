"""Hypotheses of the perspective three-point problem: a triple's solutions carry every other point into the camera."""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.rotation import cross as cross_products
from rootmatch.algebra.vector import column, column4, cross, scale_vector
from rootmatch.jit.decorators import part, scalar
from rootmatch.problems.limits import VAGUE2
from rootmatch.problems.p3p.prediction import (
    camera_frame,
    camera_triangle,
    facing_away,
    is_triple_visible,
    prediction,
    store_prediction,
    triple_from_tables,
)
from rootmatch.problems.p3p.roots import ratio_pairs, solve_all


def coordinates(t, sets, others):  # type: ignore[no-untyped-def]
    """Coordinates in each triple's frame of the other points, of their normals and of its own normals, with cosines.

    `rootmatch.problems.p3p.prediction.source_coordinates` for whole arrays: NumPy, as nothing is compiled for it.
    """
    points, normals, cosines = t.points.T, t.normals[:3].T, t.normals[3, :, None]
    origin = points[sets[:, 0]]
    e, f = points[sets[:, 1]] - origin, points[sets[:, 2]] - origin
    across = cross_products(e, f)
    with np.errstate(divide="ignore", invalid="ignore"):  # points on one line: nothing is found at infinity
        across2 = 1.0 / (across * across).sum(axis=1)
        ee, ff, ef = (e * e).sum(axis=1) * across2, (f * f).sum(axis=1) * across2, (e * f).sum(axis=1) * across2
        # rows: α, β, γ of a difference to the origin
        frame = np.stack(
            [
                ff[:, None] * e - ef[:, None] * f,
                ee[:, None] * f - ef[:, None] * e,
                across * across2[:, None],
            ],
            axis=2,
        )
        rest = np.zeros((len(sets), 7, others.shape[1]))
        rest[:, :3] = ((points[others] - origin[:, None]) @ frame).swapaxes(1, 2)
        if normals.any():
            rest[:, 3:6] = (normals[others] @ frame).swapaxes(1, 2)
        rest[:, 6] = t.normals[3][others]
        return rest, np.concatenate([normals[sets] @ frame, cosines[sets]], axis=2)


@part
def solve(t, i, j, scratch):  # type: ignore[no-untyped-def]
    """Depth ratios x = b/a and y = c/a at the four roots for every third image."""
    solve_all(t, i, j, scratch)


@scalar
def frame_of(ab2, hab, x, y, rays):  # type: ignore[no-untyped-def]
    """The triple in the camera at one root: point a, the vectors to b and to c, and their product; if it is a root."""
    depths, e, f = camera_triangle(ab2, hab, x, y, rays)
    return (x > 0.0) & (y > 0.0), scale_vector(depths[0], rays[0]) + e + f + cross(e, f)


@scalar
def known(t, grid, i, j):  # type: ignore[no-untyped-def]
    """|ab|², the versine between the bearings of a and b, and these bearings in the grid's basis."""
    u = grid.rays  # a solution does not depend on how the camera is rotated
    return t.distance2[i[0], i[1]], t.versine[j[0], j[1]], column(u, j[0]), column(u, j[1])


@scalar
def hypothesis(t, grid, before, last, scratch, root):  # type: ignore[no-untyped-def]
    """See `HypothesisKernels.frame`, of `frame_of`."""
    ab2, hab, a, b = before
    x, y = scratch[2 * root, last], scratch[2 * root + 1, last]
    return frame_of(ab2, hab, x, y, (a, b, column(grid.rays, last)))


@scalar
def gather(t, grid, a, b, c, block, k):  # type: ignore[no-untyped-def]
    """Bearings of an image triple in the grid's basis, and the versines between them, into column k."""
    u, h = grid.rays, t.versine
    block[0, k], block[1, k], block[2, k] = column(u, a)
    block[3, k], block[4, k], block[5, k] = column(u, b)
    block[6, k], block[7, k], block[8, k] = column(u, c)
    block[9, k], block[10, k], block[11, k] = h[a, b], h[b, c], h[a, c]


@part
def solve_gathered(t, i, block, count, scratch):  # type: ignore[no-untyped-def]
    """Depth ratios at the four roots for each of some gathered image triples."""
    s = t.distance2
    A, B, C = s[i[0], i[1]], s[i[1], i[2]], s[i[0], i[2]]
    for k in range(count):
        (
            scratch[0, k], scratch[1, k], scratch[2, k], scratch[3, k],
            scratch[4, k], scratch[5, k], scratch[6, k], scratch[7, k],
        ) = ratio_pairs(A, B, C, block[9, k], block[10, k], block[11, k])  # fmt: skip


@scalar
def gathered_frame(t, i, block, k, scratch, root):  # type: ignore[no-untyped-def]
    """The triple of a gathered image triple in the camera at one root, as from `hypothesis`."""
    a, b = (block[0, k], block[1, k], block[2, k]), (block[3, k], block[4, k], block[5, k])
    rays = a, b, (block[6, k], block[7, k], block[8, k])
    x, y = scratch[2 * root, k], scratch[2 * root + 1, k]
    return frame_of(t.distance2[i[0], i[1]], block[9, k], x, y, rays)


@part
def predictions(t, i, j, root, out):  # type: ignore[no-untyped-def]
    """Where every source point is predicted, its covariance, and whether it can be visible."""
    s, h = t.distance2, t.versine
    ab2, hab, source, normals, rays, variances = triple_from_tables(t, i, j)
    ratios = ratio_pairs(ab2, s[i[1], i[2]], s[i[0], i[2]], hab, h[j[1], j[2]], h[j[0], j[2]])
    x, y = ratios[0], ratios[1]
    for r in range(1, 4):
        if root == r:
            x, y = ratios[2 * r], ratios[2 * r + 1]
    if not (x > 0.0 and y > 0.0):
        return False
    frame = camera_frame(ab2, hab, x, y, rays)
    if not is_triple_visible(source, frame, normals, rays):
        return False
    for d in range(out.shape[1]):
        store_prediction(prediction(source, frame, rays, variances, column(t.points, d)), out, d)
        hidden = facing_away(source, frame, column4(t.normals, d), column(out, d)) > 0.0
        out[12, d] = 1.0 if out[9, d] + out[11, d] < VAGUE2 and not hidden else 0.0
    return True

"""Both constraints of a P3P hyper-edge at once, by carrying a triple's solution to the fourth point.

A 4-tuple has eight image coordinates and six unknowns of the pose, so two independent constraints: the two coordinates
of the fourth point's bearing across the one that the triple predicts (`prediction`). To first order this is the χ² of
all resultants of the 4-tuple together, but linearised at a solution of the triple instead of at a root blurred by the
other quartic: where a triple has two near solutions (a distant camera sees each triangle and its reversal) the null
vector of the Bézout matrix mixes them, and 15 to 40 % of the true hyper-edges were lost. All that depends on abc is
computed once for every d and every image of it.
"""

from __future__ import annotations

from math import inf

import numpy as np

from rootmatch.algebra.vector import column, column4
from rootmatch.jit.decorators import kernel
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.p3p.prediction import (
    camera_frame,
    facing_away,
    is_triple_visible,
    load_prediction,
    prediction,
    squared_deviation,
    store_prediction,
    triple_from_tables,
)
from rootmatch.problems.p3p.roots import ratio_pairs, solve_all


@kernel
def slab(t, kind, i, j, first, panel, scratch, out):  # type: ignore[no-untyped-def]
    """Slab kernel of `Joint`: squares."""
    ab2, hab, source, normals, rays, variances = triple_from_tables(t, i, j)
    px, py, pz = t.points[0, first:], t.points[1, first:], t.points[2, first:]
    rx, ry, rz, v = t.rays[0], t.rays[1], t.rays[2], t.variance
    rows, columns = out.shape
    for r in range(rows):
        for m in range(columns):
            out[r, m] = UNINFORMATIVE * UNINFORMATIVE
    for root in range(4):
        x, y = panel[2 * root, j[2]], panel[2 * root + 1, j[2]]
        if not (x > 0.0 and y > 0.0):
            continue
        frame = camera_frame(ab2, hab, x, y, rays)
        if not is_triple_visible(source, frame, normals, rays):
            continue
        for r in range(rows):
            predicted = prediction(source, frame, rays, variances, (px[r], py[r], pz[r]))
            store_prediction(predicted, scratch, r)
            if facing_away(source, frame, column4(t.normals, first + r), predicted[0]) > 0.0:
                scratch[9, r] = inf  # a prediction without meaning
        for r in range(rows):
            predicted = load_prediction(scratch, r)
            line = out[r]
            for m in range(columns):
                line[m] = min(line[m], squared_deviation(predicted, (rx[m], ry[m], rz[m]), v[m]))


@kernel
def edge(t, kind, i, j):  # type: ignore[no-untyped-def]
    """Edge kernel of `Joint`; whichever triple predicts, the constraints are the same to first order."""
    s, h = t.distance2, t.versine
    ab2, hab, source, normals, rays, variances = triple_from_tables(t, i, j)
    ratios = ratio_pairs(ab2, s[i[1], i[2]], s[i[0], i[2]], hab, h[j[1], j[2]], h[j[0], j[2]])
    d, k = i[3], j[3]
    minimum = UNINFORMATIVE * UNINFORMATIVE
    for root in range(4):
        x, y = ratios[2 * root], ratios[2 * root + 1]
        if x > 0.0 and y > 0.0:
            frame = camera_frame(ab2, hab, x, y, rays)
            if not is_triple_visible(source, frame, normals, rays):
                continue
            predicted = prediction(source, frame, rays, variances, column(t.points, d))
            if facing_away(source, frame, column4(t.normals, d), predicted[0]) > 0.0:
                continue
            minimum = min(minimum, squared_deviation(predicted, column(t.rays, k), t.variance[k]))
    return np.sqrt(minimum)


@kernel
def fill_panel(t, kind, i, j, panel):  # type: ignore[no-untyped-def]
    """Panel kernel of `Joint`: the roots for every third image."""
    solve_all(t, i, j, panel)

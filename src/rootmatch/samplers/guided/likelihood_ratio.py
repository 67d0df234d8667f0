"""The sequential test of one hypothesis, and which of those that pass it survive: those of the highest ratio."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.decorators import part, scalar
from rootmatch.samplers.guided.detection_grid import detection_at, field_of


@part
def find_weakest(ratios):  # type: ignore[no-untyped-def]
    """Place of the lowest ratio of a chunk, which the next survivor takes."""
    weakest = 0
    for q in range(ratios.size):
        if ratios[q] < ratios[weakest]:
            weakest = q
    return weakest


@scalar
def likelihood_ratio(grid, test, others, coordinates, masked, allowed, frame, stamp, tick):  # type: ignore[no-untyped-def]
    """Log-likelihood ratio of a frame in the grid's basis, hits, points looked up; −∞ when dropped.

    Points seen edge-on may well go undetected: they are left out, unless they are more than the others. Then they come
    last, if those have not dropped the frame, and count where they are met: all of a plate may be seen so.
    """
    ox, oy, oz, ex, ey, ez, fx, fy, fz, gx, gy, gz = frame
    ratio = 0.0
    hits = 0
    looked = 0
    fall = test.fall / grid.gate2
    cells, positions, rays, field, gate2 = grid.cells, grid.positions, grid.rays, field_of(grid), grid.gate2
    whole = grid.whole
    facing2 = test.facing * test.facing
    from_edge = 0
    for turn in range(2):
        edge_on = turn == 1
        if edge_on and from_edge <= looked:
            break
        miss = 0.0 if edge_on else test.miss
        for r in range(others.shape[0]):
            a, b, c = coordinates[0, r], coordinates[1, r], coordinates[2, r]
            x = ox + a * ex + b * fx + c * gx
            y = oy + a * ey + b * fy + c * gy
            z = oz + a * ez + b * fz + c * gz
            if test.normals:
                a, b, c = coordinates[3, r], coordinates[4, r], coordinates[5, r]
                u, v, w = a * ex + b * fx + c * gx, a * ey + b * fy + c * gy, a * ez + b * fz + c * gz
                along = u * x + v * y + w * z
                distance2 = x * x + y * y + z * z
                # beyond its view angle, or so nearly on the far side that it need not be seen
                if along + coordinates[6, r] * math.sqrt(distance2) > 0.0:
                    continue
                if (along * along < facing2 * (u * u + v * v + w * w) * distance2) != edge_on:
                    from_edge += 1
                    continue
            looked += 1
            k, distance2 = detection_at(cells, positions, rays, field, gate2, whole, x, y, z)
            if k >= 0 and stamp[k] != tick and (not masked or allowed[others[r], k]):
                stamp[k] = tick
                hit = test.hit - fall * distance2
                ratio += hit if hit > miss else miss
                hits += 1
            else:
                ratio += miss
                if ratio < test.floor:
                    return -np.inf, hits, looked
    return ratio, hits, looked


@part
def keep_survivor(survivors, ratios, weakest, ratio, found):  # type: ignore[no-untyped-def]
    """Put a triple, its root and three images in the place of the weakest survivor; the place of the weakest then."""
    ratios[weakest] = ratio
    for p in range(5):
        survivors[weakest, p] = found[p]
    return find_weakest(ratios)


@part
def keep_likeliest(  # type: ignore[no-untyped-def]
    grid, test, others_of, coordinates_of, masked, allowed, hypotheses, filled, stamp, tick, images, survivors, ratios
):  # fmt: skip
    """Test what the screening leaves, one by one; the last stamp used, and how many points were looked up.

    Images of sets are places in ``images``; those of survivors are detections.
    """
    frames, picked = hypotheses
    m, looked = picked.shape[1] - 2, 0
    weakest = find_weakest(ratios)
    for q in range(filled):
        s = picked[q, 0]
        tick += 1
        for p in range(m):
            stamp[images[picked[q, 2 + p]]] = tick
        frame = (
            frames[q, 0], frames[q, 1], frames[q, 2], frames[q, 3], frames[q, 4], frames[q, 5],
            frames[q, 6], frames[q, 7], frames[q, 8], frames[q, 9], frames[q, 10], frames[q, 11],
        )  # fmt: skip
        ratio, hits, own = likelihood_ratio(
            grid, test, others_of[s], coordinates_of[s], masked, allowed, frame, stamp, tick
        )  # fmt: skip
        looked += own
        if ratio > ratios[weakest] and hits + m >= test.minimum:
            ratios[weakest] = ratio
            survivors[weakest, 0], survivors[weakest, 1] = s, picked[q, 1]
            for p in range(m):
                survivors[weakest, 2 + p] = images[picked[q, 2 + p]]
            weakest = find_weakest(ratios)
    return tick, looked

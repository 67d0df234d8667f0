"""Verification of hypotheses: their evidence, from the covariance of each prediction and the density of detections."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, scalar
from rootmatch.problems.limits import GATE
from rootmatch.samplers.guided.dispatch import predict_set

BEHIND2 = 1e11
"""χ² of a detection behind the camera: beyond every gate."""


VISIBLE = (0.95, 0.6, 0.25, 0.1)
"""Probabilities that a source point is visible, over which the evidence is averaged; and the share of the points that
detections can be of, where it is less than each of these."""
CANDIDATES = 4
"""Detections kept for one source point of a hypothesis."""


def verify(
    tables: Any, points: Integers, images: Integers, density: Floats, allowed: Bools
) -> tuple[Floats, Integers, Integers]:
    """Evidence for hypotheses from the covariance of each prediction.

    The ratio of one source point is (1 − v) + v N(e; S) / λ: e is the distance of its best detection, S the covariance,
    λ the density of the detections that it may have and v the probability that it is visible. Its mean by chance is 1,
    so a product of T or more comes by chance once in T trials. Several v are averaged.

    Parameters
    ----------
    tables
    points : (K, m) int64 array
        Minimal sets of source points.
    images : (K, 1 + m) int64 array
        Root, and image of each of the points.
    density : (n',) array
        Of all detections about each.
    allowed : (n, n') bool array, or (0, 0) for all

    Returns
    -------
    evidence : (K,) array
        Logarithm of the product; −∞ where the root is not there.
    best : (K, n) int64 array
        One detection for each source point, none twice; −1 for none.
    candidates : (K, n, c) int64 array
        Detections within the gate, nearest first, then −1.
    """
    count, n, n_target = len(points), tables.points.shape[1], tables.rays.shape[1]
    evidence, best = np.empty(count), np.empty((count, n), np.int64)
    candidates = np.empty((count, n, CANDIDATES), np.int64)
    scratch = (
        np.empty((13, n)), np.empty(n_target, np.int64), np.empty(n), np.empty(CANDIDATES), np.empty(n_target)
    )  # fmt: skip
    share = n_target / n
    visible = np.array([*VISIBLE, share] if share < VISIBLE[-1] else VISIBLE)
    gate2, shares = GATE**2, allowed_shares(allowed, n)
    roots, sets = images[:, 0].copy(), images[:, 1:].copy()
    _verify(tables, points, roots, sets, density, shares, gate2, allowed, visible, *scratch, evidence, best, candidates)
    return evidence, best, candidates


def allowed_shares(allowed: Bools, n: int) -> Floats:
    """Share (n,) of the detections that each point may have, by (n, n') of them or (0, 0) for all."""
    return np.asarray(allowed.mean(axis=1)) if allowed.size else np.ones(n)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def _verify(  # type: ignore[no-untyped-def]
    tables, points, roots, images, density, shares, gate2, allowed, visible, out, owner, strength, distances, beyond,
    evidence, best, candidates,
):  # fmt: skip
    """Fill in evidence, best and candidates; the arrays before them are scratch."""
    tables, points, images, allowed, out = borrow((tables, points, images, allowed, out))
    roots, visible, owner, strength, distances = borrow((roots, visible, owner, strength, distances))
    shares = borrow(shares)
    evidence, best, candidates, density, beyond = borrow((evidence, best, candidates, density, beyond))
    rays, variance = tables.rays, tables.variance
    count, m = points.shape
    n, n_target = best.shape[1], owner.size
    masked, places = allowed.shape[0] > 0, distances.size
    for q in range(count):
        i = points[q]
        j = images[q]
        evidence[q] = -np.inf
        for d in range(n):
            best[q, d] = -1
            for place in range(places):
                candidates[q, d, place] = -1
        if not predict_set(tables, i, j, roots[q], out):
            continue
        for k in range(n_target):
            owner[k] = -1
        for d in range(n):
            strength[d] = 0.0
        for d in range(n):
            member = -1
            for p in range(m):
                if i[p] == d:
                    member = p
            if member >= 0:
                best[q, d] = j[member]
                candidates[q, d, 0] = j[member]
                owner[j[member]] = d
                strength[d] = np.inf
        for d in range(n):
            if best[q, d] >= 0 or out[12, d] == 0.0:
                continue
            held = 0
            # far off along one of the axes is far off, as most detections are; in a loop that vectorises
            x, y, z, spread = out[3, d], out[4, d], out[5, d], out[9, d]
            u, v, w, width = out[6, d], out[7, d], out[8, d], out[11, d]
            for k in range(n_target):
                along = x * rays[0, k] + y * rays[1, k] + z * rays[2, k]
                across = u * rays[0, k] + v * rays[1, k] + w * rays[2, k]
                far = along * along - gate2 * (spread + variance[k])
                wide = across * across - gate2 * (width + variance[k])
                beyond[k] = far if far > wide else wide
            for k in range(n_target):
                if beyond[k] > 0.0 or (masked and not allowed[d, k]):
                    continue
                chi2, determinant = _squared_distance(rays, variance, out, d, k)
                if not (chi2 <= gate2):
                    continue
                met = density[k] * shares[d]
                ratio = math.exp(-0.5 * chi2) / (2.0 * math.pi * math.sqrt(determinant) * met)
                # the stronger claim of two source points on one detection holds
                if ratio > strength[d] and (owner[k] < 0 or ratio > strength[owner[k]]):
                    if best[q, d] >= 0:
                        owner[best[q, d]] = -1
                    if owner[k] >= 0:
                        best[q, owner[k]] = -1
                        strength[owner[k]] = 0.0
                    owner[k] = d
                    best[q, d] = k
                    strength[d] = ratio
                place = held if held < places else places - 1
                if held < places or chi2 < distances[place]:
                    while place > 0 and distances[place - 1] > chi2:
                        distances[place] = distances[place - 1]
                        candidates[q, d, place] = candidates[q, d, place - 1]
                        place -= 1
                    distances[place] = chi2
                    candidates[q, d, place] = k
                    held = held + 1 if held < places else held
        total = -np.inf
        for s in range(visible.size):
            logarithm = 0.0
            for d in range(n):
                if out[12, d] != 0.0 and strength[d] < np.inf:
                    logarithm += math.log((1.0 - visible[s]) + visible[s] * strength[d])
            top = total if total > logarithm else logarithm
            total = top + math.log(math.exp(total - top) + math.exp(logarithm - top))
        evidence[q] = total - math.log(visible.size)
    return evidence, best, candidates


@scalar
def _squared_distance(rays, variance, out, d, k):  # type: ignore[no-untyped-def]
    """χ² of detection k about the prediction of source point d, and the determinant of their covariance."""
    x, y, z = rays[0, k], rays[1, k], rays[2, k]
    f = out[3, d] * x + out[4, d] * y + out[5, d] * z
    g = out[6, d] * x + out[7, d] * y + out[8, d] * z
    a = out[9, d] + variance[k]
    b = out[11, d] + variance[k]
    c = out[10, d]
    determinant = a * b - c * c
    chi2 = (f * f * b - 2.0 * f * g * c + g * g * a) / determinant
    ahead = out[0, d] * x + out[1, d] * y + out[2, d] * z > 0.0
    return (chi2 if ahead and chi2 >= 0.0 else BEHIND2), determinant

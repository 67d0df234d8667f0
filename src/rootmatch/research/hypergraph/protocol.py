"""Point sets and tensors of the public protocols: deformation and outliers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.hypergraph.enumeration import subsets
from rootmatch.hypergraph.invariants import signed_sines
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.research.paper.settings import Setting

DEFORMATION, OUTLIERS = "deformation", "outliers"
POINTS = {DEFORMATION: 20, OUTLIERS: 10}
"""Source points; outliers are in the target alone."""
OUTLIER_NOISE = 0.01

SETTINGS: dict[str, tuple[Setting, ...]] = {
    DEFORMATION: tuple(Setting(DEFORMATION, 0, round(0.05 * k, 2)) for k in range(9)),
    OUTLIERS: tuple(Setting(OUTLIERS, k, OUTLIER_NOISE) for k in range(0, 201, 20)),
}
"""Settings of both protocols; noise is in units of the spread of the points."""

ORDERS = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)])
"""All orders of a triangle's points; the last three turn it over."""
SIGNS = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
"""Of the sines in each of them."""


class Instance(NamedTuple):
    """Points (n, 2) and (n', 2) and the target of each source point (n,)."""

    source: Floats
    target: Floats
    truth: Integers


def instance(setting: Setting, seed: int) -> Instance:
    """P ~ N(0, I), Q = P + σN and outliers ~ N(0, I), shuffled."""
    n = POINTS[setting.problem]
    rng = np.random.default_rng((seed, setting.outliers, round(1000 * setting.noise)))
    source = rng.normal(size=(n, 2))
    moved = source + setting.noise * rng.normal(size=(n, 2))
    order = rng.permutation(n + setting.outliers)
    target = np.concatenate((moved, rng.normal(size=(setting.outliers, 2))))[order]
    return Instance(source, target, np.argsort(order)[:n])


def protocol_tensor(points: Instance, seed: int) -> AffinityTensor:
    """Hyper-edges of order 3 between triangles with alike angles.

    n·n' random source triangles are drawn, each possibly several times; of all triangles of the target, in all orders,
    the n·n' with the nearest *signed* sines make hyper-edges with it, of weight exp(−d / mean d). A hyper-edge counts
    as often as its triangle was drawn, as a multiple of its weight; the mean is over all draws.

    Source: Duchenne, Bach, Kweon and Ponce, PAMI 2011; Lee, Cho and Lee, CVPR 2011; Nguyen, Tudisco, Gautier and Hein,
    PAMI 2017. Their codes ask for approximate neighbours (up to 11 times as far as the nearest); these are the nearest.
    """
    n, n_target = len(points.source), len(points.target)
    count = n * n_target
    rng = np.random.default_rng((seed, n, n_target, 1))
    drawn = np.sort(rng.permuted(np.tile(np.arange(n), (count, 1)), axis=1)[:, :3], axis=1)
    chosen, times = np.unique(drawn, axis=0, return_counts=True)
    of_target = subsets(n_target, 3)
    triangle, order, distance = nearest_triangles(
        signed_sines(points.source[chosen]), signed_sines(points.target[of_target]), count
    )
    found = np.take_along_axis(of_target[triangle], ORDERS[order], axis=-1)
    indices = (chosen[:, None, :] * n_target + found).reshape(-1, 3).astype(np.int32)
    mean = float(np.average(distance.mean(axis=1), weights=times))
    weights: Floats = np.exp(-distance / mean) * times[:, None]
    return AffinityTensor.unchecked(indices, weights.ravel(), (n, n_target))


def nearest_triangles(asked: Floats, sines: Floats, count: int) -> tuple[Integers, Integers, Floats]:
    """The triangles, in any order of their points, whose sines are nearest to each of those asked for.

    Parameters
    ----------
    asked : (S, 3) array
    sines : (T, 3) array
    count : int
        Neighbours of each, at most 6 T.

    Returns
    -------
    triangle, order : (S, count) arrays
        Row of ``sines`` and row of ``ORDERS``, in no particular order.
    distance : (S, count) array
    """
    from scipy.spatial import cKDTree  # slow to import

    tree, each = cKDTree(sines), min(count, len(sines))
    # a triangle in an order is as far from what is asked as it is, as it stands, from that in the inverse order
    found = [
        tree.query(sign * asked[:, np.argsort(order)], k=[*range(1, each + 1)])
        for order, sign in zip(ORDERS, SIGNS, strict=True)
    ]
    distance, triangle = (np.concatenate(part, axis=1) for part in zip(*found, strict=True))
    count = min(count, distance.shape[1])
    kept = np.argpartition(distance, count - 1, axis=1)[:, :count]
    triangle, distance = (np.take_along_axis(part, kept, axis=1) for part in (triangle, distance))
    return triangle, kept // each, distance

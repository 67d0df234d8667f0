"""Hyper-edges by invariants: what a tuple of points keeps under a transformation, compared between two sets.

Where each set has quantities that the transformation keeps, a hyper-edge is weighted by how far these
differ, and only the most alike tuples are kept: a tree over the target's tuples finds them (Duchenne et al. 2011). The
other problems of this package are those that have no such invariants.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.arrays import Floats, Integers, as_floats
from rootmatch.errors import InputError
from rootmatch.hypergraph.enumeration import subsets
from rootmatch.hypergraph.random_tuples import distinct_sets
from rootmatch.hypergraph.rows import first_rows
from rootmatch.problems.checks import check_points

TARGET_TUPLES = 2_000_000
"""Target tuples beyond which a random part of them is used. Not tuned: a round value."""
TREE_TUPLES = 2_000_000
"""Target tuples, each in several orders, that one tree holds at most, in some hundreds of megabytes: a round value."""


@dataclass(frozen=True)
class Invariant:
    """A feature of point tuples that is compared between the two sets.

    Parameters
    ----------
    order : int
        Points of a tuple.
    dimensions : tuple of int
        Of the points for which it is defined.
    features : callable
        Points (T, order, k) to features (T, f), finite.
    """

    order: int
    dimensions: tuple[int, ...]
    features: Callable[[Floats], Floats]


def angle_sines(points: Floats) -> Floats:
    """Sines (T, 3) of the angles of triangles (T, 3, k) at their points: kept by similarity (Duchenne et al. 2011)."""
    sides = np.stack([points[:, (k + 2) % 3] - points[:, (k + 1) % 3] for k in range(3)], axis=1)
    lengths = np.linalg.norm(sides, axis=2)
    first, second = sides[:, 0], sides[:, 1]
    dots = (first * second).sum(axis=1)
    area2 = np.sqrt(np.maximum((first**2).sum(axis=1) * (second**2).sum(axis=1) - dots**2, 0.0))
    # twice the area is the product of two sides and the sine between them
    products = np.stack([lengths[:, (k + 1) % 3] * lengths[:, (k + 2) % 3] for k in range(3)], axis=1)
    sines: Floats = area2[:, None] / np.maximum(products, 1e-300)
    return sines


def signed_sines(points: Floats) -> Floats:
    """`angle_sines` of triangles of a plane (T, 3, 2), negative for clockwise ones: a reflection changes their sign.

    What the code of Duchenne et al. computes, and with it all later ones that match points of a plane.
    """
    first, second = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    area2 = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    signed: Floats = np.sign(area2)[:, None] * angle_sines(points)
    return signed


def side_lengths(points: Floats) -> Floats:
    """Lengths (T, 3) of the sides of triangles (T, 3, k) opposite their points: kept by rigid motion."""
    lengths: Floats = np.stack(
        [np.linalg.norm(points[:, (k + 2) % 3] - points[:, (k + 1) % 3], axis=1) for k in range(3)], axis=1
    )
    return lengths


def cross_ratios(points: Floats) -> Floats:
    """Two cross-ratios of five points of a plane (T, 5, 2), kept by any homography, as four numbers (T, 4).

    A cross-ratio N / D lives on the projective line and may be infinite: it is given as the cosine and sine of
    2 atan2(N, D), in which near values are near. With |ijk| the determinant of three homogeneous points they are
    |431||521| / |421||531| and |421||532| / |432||521| (Mundy & Zisserman 1992, appendix).
    """
    homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)

    def bracket(i: int, j: int, k: int) -> Floats:
        area: Floats = np.linalg.det(homogeneous[:, [i - 1, j - 1, k - 1]])
        return area

    one = bracket(4, 3, 1) * bracket(5, 2, 1), bracket(4, 2, 1) * bracket(5, 3, 1)
    two = bracket(4, 2, 1) * bracket(5, 3, 2), bracket(4, 3, 2) * bracket(5, 2, 1)
    angles = [2.0 * np.arctan2(numerator, denominator) for numerator, denominator in (one, two)]
    return np.stack([f(angle) for angle in angles for f in (np.cos, np.sin)], axis=1)


INVARIANTS = {
    "angles": Invariant(3, (2, 3), angle_sines),
    "signed-angles": Invariant(3, (2,), signed_sines),
    "distances": Invariant(3, (2, 3), side_lengths),
    "cross-ratios": Invariant(5, (2,), cross_ratios),
}


def nearest_hyperedges(
    source: ArrayLike,
    target: ArrayLike,
    invariant: str | Invariant = "angles",
    *,
    tuples: int | None = None,
    neighbours: int | None = None,
    seed: int = 0,
) -> tuple[NDArray[np.int32], NDArray[np.int32], Floats]:
    """Hyper-edges whose tuples have the most alike invariants.

    Random tuples of source points are drawn; for each, the nearest tuples of the target are found among all of them, in
    all orders.

    Parameters
    ----------
    source, target : (n, k) and (n', k) arrays
        Points of a plane or of space.
    invariant : {"angles", "signed-angles", "distances", "cross-ratios"} or Invariant
        What is alike up to a similarity, one without mirroring (of a plane), a rigid motion, a homography.
    tuples : int, optional
        Source tuples, n · n' if not given; all where there are fewer.
    neighbours : int, optional
        Target tuples for each, n · n' if not given.
    seed : int

    Returns
    -------
    source_index, target_index : (E, d) int32 arrays
    distance : (E,) array
        Between the invariants of both tuples.

    Raises
    ------
    InputError
        If the points or numbers cannot be used.

    Notes
    -----
    Degenerate: points on a line have sines of 0 and are all alike, whatever their distances; so are cross-ratios of
    five points of which four are on a line. Symmetric sets have several right matches. Noise plays no part: small
    tuples, whose features it moves far, count like large ones; `rootmatch.Similarity` and `rootmatch.Rigid` model it.
    """
    from scipy.spatial import cKDTree  # slow to import

    chosen = _choose_invariant(invariant)
    dimension = np.shape(np.asarray(source))[-1] if np.ndim(source) == 2 else 0
    if dimension not in chosen.dimensions:
        raise InputError(
            f"source: shape {np.shape(source)} given; this invariant takes points of "
            f"{' or '.join(map(str, chosen.dimensions))} coordinates, (n, {chosen.dimensions[0]})"
        )
    first = check_points(source, dimension, "source", chosen.order, of="this invariant")
    second = check_points(target, dimension, "target", chosen.order, of="this invariant")
    n, n_target = len(first), len(second)
    wanted = _check_count(tuples, n * n_target, "tuples")
    near = _check_count(neighbours, n * n_target, "neighbours")
    rng = np.random.default_rng(seed)
    of_source = _tuples(n, chosen.order, wanted, rng)
    of_target = _tuples(n_target, chosen.order, TARGET_TUPLES, rng)
    queried = _features(chosen, first[of_source])
    orders = np.array(list(permutations(range(chosen.order))))
    gaps, targets = [], []
    for few in np.array_split(orders, math.ceil(len(orders) * len(of_target) / TREE_TUPLES)):
        several = of_target[:, few].reshape(-1, chosen.order)
        gap, place = cKDTree(_features(chosen, second[several])).query(queried, k=min(near, len(several)))
        gaps.append(gap.reshape(len(queried), -1))
        targets.append(several[place.reshape(len(queried), -1)])
    gap, target_index = np.concatenate(gaps, axis=1), np.concatenate(targets, axis=1)
    if len(gaps) > 1:  # the nearest of each tree, of which as many are the nearest of all
        keep = np.argpartition(gap, min(near, gap.shape[1]) - 1, axis=1)[:, :near]
        gap, target_index = (
            np.take_along_axis(*one, axis=1) for one in ((gap, keep), (target_index, keep[:, :, None]))
        )
    return (
        np.repeat(of_source, gap.shape[1], axis=0).astype(np.int32),
        target_index.reshape(-1, chosen.order).astype(np.int32),
        gap.ravel(),
    )


def invariant_affinities(
    source: ArrayLike,
    target: ArrayLike,
    invariant: str | Invariant = "angles",
    *,
    tuples: int | None = None,
    neighbours: int | None = None,
    seed: int = 0,
) -> tuple[NDArray[np.int32], Floats, tuple[int, int]]:
    """Affinities of tuples with similar invariants, for ``AffinityTensor(*invariant_affinities(source, target))``.

    Parameters as for `nearest_hyperedges`.

    Returns
    -------
    indices : (E, d) int32 array
        Flat correspondences i · n' + i'.
    weights : (E,) array
        exp(−distance / mean distance), as in the classical protocols.
    shape : (n, n')

    Raises
    ------
    InputError
        As `nearest_hyperedges`.
    """
    source_index, target_index, distance = nearest_hyperedges(
        source, target, invariant, tuples=tuples, neighbours=neighbours, seed=seed
    )
    n_target = len(np.asarray(target))
    mean = float(distance.mean())
    weights = np.exp(-distance / mean) if mean > 0.0 else np.ones(len(distance))
    indices = (source_index * n_target + target_index).astype(np.int32)
    # one tuple can be near another in two orders; the more alike one counts
    by_weight = np.argsort(-weights, kind="stable")
    kept = np.sort(by_weight[first_rows(np.sort(indices, axis=1)[by_weight], len(np.asarray(source)) * n_target)])
    return indices[kept], weights[kept], (len(np.asarray(source)), n_target)


def _choose_invariant(invariant: str | Invariant) -> Invariant:
    if isinstance(invariant, Invariant):
        return invariant
    if invariant not in INVARIANTS:
        raise InputError(f"invariant: {invariant!r} given; one of {', '.join(INVARIANTS)} expected")
    return INVARIANTS[invariant]


def _features(invariant: Invariant, points: Floats) -> Floats:
    """The features (T, f) of tuples of points (T, order, k), which a caller's own function may get wrong."""
    features = as_floats(invariant.features(points), "features of the invariant", f"shape ({len(points)}, f)")
    if features.ndim != 2 or len(features) != len(points) or not np.isfinite(features).all():
        wrong = f"shape {features.shape}" if features.ndim != 2 or len(features) != len(points) else "NaN or infinity"
        raise InputError(
            f"invariant: features of {wrong} for points of shape {points.shape}; give finite numbers of shape "
            f"({len(points)}, f), a row for each tuple"
        )
    return features


def _check_count(given: int | None, default: int, name: str) -> int:
    if given is None:
        return default
    if int(given) != given or given < 1:
        raise InputError(f"{name}: {given!r} given; give a positive whole number")
    return int(given)


def _tuples(points: int, order: int, maximum: int, rng: np.random.Generator) -> Integers:
    """All increasing tuples (T, order) of indices, or so many different random ones where there are more."""
    count = math.comb(points, order)
    if count <= maximum:
        return subsets(points, order)
    found = np.empty((0, order), dtype=np.int64)
    while len(found) < maximum:
        merged = np.concatenate([found, distinct_sets(rng, 2 * maximum, points, order)])
        _, first = np.unique(merged, axis=0, return_index=True)
        found = merged[np.sort(first)]
    return found[:maximum]

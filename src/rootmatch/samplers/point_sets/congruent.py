"""All labellings of a small point set by congruent triples: each names a motion, and that the rest of the labelling."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import triangle_frames
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import active_deadline
from rootmatch.hypergraph.enumeration import subsets
from rootmatch.problems.points import PointClouds, distances, mutual_nearest
from rootmatch.problems.pose_fit.point_set_fit import fit_point_sets
from rootmatch.samplers.point_sets.motions import WIDE, Motions, concatenate_motions, fit_motions
from rootmatch.samplers.point_sets.place_grid import PlaceGrid
from rootmatch.samplers.point_sets.shown_parts import squared_areas
from rootmatch.samplers.point_sets.triangles import TURNED, Triangles

GATE = 4.5
"""Deviation in σ up to which distances within a triple agree. A round value: a labelling is lost only if all of its
triples are."""
NEAR = 6.0
"""Gate in σ once the motion is fitted to all of its points. A round value."""
MAX_LOOKED_UP = 3_000_000
"""Pairs of triples' first two points and targets that are compared: a tenth of a second."""
MAX_MOTIONS = 6_000
"""Triples of targets that are followed up, those of the widest triples of source points first: a tenth of a second."""
MAX_KEPT = 256
"""Distinct labellings that are returned, those that tell the most about their motion first. A round value."""
MAX_FITTED = 2048
"""Distinct labellings whose motions are fitted, those with the most matches first: a twentieth of a second."""
TOGETHER = 64
"""Triples of the source that are compared with those of the targets at once: enough are mostly among the first ones."""
REFLECTED = 4
"""Triples of a labelling in which it is reflected, the widest ones: one of them may be wrong. A round value."""
CELLS = 200_000
"""Distances that are computed between two looks at the time: two milliseconds."""


def is_small(clouds: PointClouds) -> bool:
    """Whether all triples of the source can be laid onto all those of the targets in a moment."""
    n, n_target = len(clouds.source), len(clouds.target)
    looked_up = n * (n - 1) * (n - 2) // 6 * n_target**2
    return looked_up * (n_target if clouds.scaled else 1) <= MAX_LOOKED_UP


class Labellings(NamedTuple):
    """Labellings (K, n) that motions explain, −1 for unmatched."""

    proper: Integers
    """Labellings by motions of the kind that is looked for."""
    mirrored: Integers
    """Labellings by reflections, if none is looked for: only those with more matches than any of the others."""
    tried: int
    """Number of motions tried."""
    cut: bool
    """Whether more triples are alike than are followed up: the noise is large."""


def congruent_labellings(clouds: PointClouds, mirror: bool, allowed: Bools | None = None) -> Labellings:
    """Labellings of three points or more that a motion explains.

    Every triple of source points is laid onto every triple of targets like it. Each of these motions labels the points
    that it brings next to a target, is fitted to them, and labels once more. At the deadline in force the triples that
    are left, the least wide ones, are left out.

    Parameters
    ----------
    clouds : PointClouds
    mirror : bool
        Whether motions may be reflections.
    allowed : (n, n') bool array, optional
        Possible correspondences.
    """
    clouds = clouds.with_means
    source, target = _congruent_triples(clouds, allowed)
    cut = len(source) == MAX_MOTIONS
    found = grow_labellings(
        clouds, label_by_motions(clouds, _motions(clouds, source, target, mirror), allowed), mirror, allowed
    )
    maximum = int((found >= 0).sum(axis=1).max(initial=2))
    if mirror or maximum >= min(len(clouds.source), len(clouds.target)):
        return Labellings(found, found[:0], len(source), cut)
    mirrored = _label_reflected(clouds, source, target, maximum + 1, allowed)
    return Labellings(found, mirrored, 2 * len(source), cut)


def reflected_labellings(clouds: PointClouds, labelling: Integers, allowed: Bools | None = None) -> Integers:
    """Labellings (M, n) of points in space, with more matches than one (n,), by reflections in what that matches.

    Three points have no handedness: what has them where the body does may be its mirror image, which has the rest too.
    """
    own, maximum = np.flatnonzero(labelling >= 0), min(len(clouds.source), len(clouds.target))
    if clouds.source.shape[1] != 3 or not 3 <= len(own) < maximum or not is_small(clouds):
        return np.empty((0, len(labelling)), np.int64)
    clouds = clouds.with_means
    triples = own[_triangles_widest_first(distances(clouds.source[own]))[:REFLECTED]]
    return _label_reflected(clouds, triples, labelling[triples], len(own) + 1, allowed)


def _label_reflected(
    clouds: PointClouds, source: Integers, target: Integers, minimum: int, allowed: Bools | None
) -> Integers:
    """Labellings (M, n) of so many matches, at least, by the reflections that take triples onto triples."""
    mirrored = label_by_motions(clouds, _motions(clouds, source, target, True)[-1:], allowed, minimum)
    return grow_labellings(clouds, mirrored, True, allowed)


def grow_labellings(clouds: PointClouds, found: Integers, mirror: bool, allowed: Bools | None) -> Integers:
    """Labellings (K, n) of three points or more, and those by the motions that are fitted to them."""
    found = found[(found >= 0).sum(axis=1) >= 3][:MAX_FITTED]
    if not len(found):
        return found
    clouds = clouds.with_means
    fit = fit_point_sets(clouds, found, mirror)
    again = _label_in_parts(clouds, len(found), lambda some: fit.take(some).squares(), NEAR, allowed)
    every = _distinct_labellings([found, again], 3)
    if len(every) <= MAX_KEPT:
        return every
    return np.asarray(every[np.argsort(-_labelling_information(clouds, every, mirror), kind="stable")[:MAX_KEPT]])


def _labelling_information(clouds: PointClouds, labellings: Integers, mirror: bool) -> Floats:
    """What labellings (K, n) tell, (K,): log-likelihood ratios of matches near their motions against chance.

    Where points repeat, some motion brings many of them roughly to targets, and fewer exactly.
    """
    moved, own = (fit := fit_point_sets(clouds, labellings, mirror)).places
    at = np.maximum(labellings, 0)
    variance = own + (fit.scale**2)[:, None] * clouds.source_variance + clouds.target_variance[at]
    size, n_target = clouds.target.shape[1], len(clouds.target)
    centred = clouds.target - clouds.target.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False) * math.sqrt(12.0 / n_target)  # that of a box
    log_chance = math.log(n_target) - float(np.log(np.maximum(spread, math.sqrt(float(variance.min())))).sum())
    squared = ((moved - clouds.target[at]) ** 2).sum(axis=2)
    ratio = -0.5 * (squared / variance + size * np.log(2.0 * math.pi * variance)) - log_chance
    return np.asarray(np.where(labellings >= 0, np.maximum(ratio, 0.0), 0.0).sum(axis=1))


def _congruent_triples(clouds: PointClouds, allowed: Bools | None) -> tuple[Integers, Integers]:
    """Triples of source points and of targets (H, 3) of the same shape, those of the widest source points first."""
    near, rng = distances(clouds.source), np.random.default_rng(0)
    triples = _triangles_widest_first(near)
    found, seen = [(triples[:0], triples[:0])], 0
    with active_deadline().within():
        others = Triangles(clouds.target, clouds.target_variance, clouds.scaled, GATE)
        for start in range(0, len(triples), TOGETHER):
            some = triples[start : start + TOGETHER]
            alike = others.alike(some, near, clouds.source_variance, allowed, rng)
            order = np.lexsort((*alike.corners.T[::-1], alike.number))
            found.append((some[alike.number[order]], alike.corners[order]))
            seen += len(order)
            if seen >= MAX_MOTIONS:
                break
    first, second = (np.concatenate(part)[:MAX_MOTIONS] for part in zip(*found, strict=True))
    return first, second


def _triangles_widest_first(near: Floats) -> Integers:
    """Triples (T, 3) of points with such distances (n, n) by falling area, not on a line, the longest side first.

    Few pairs of targets are as far apart as that, and a scale is best known from it.
    """
    triples = subsets(len(near), 3)
    a, b, c = triples.T
    sides = np.stack([near[a, b], near[b, c], near[a, c]])
    wide = squared_areas(near, triples)
    order = np.argsort(-wide, kind="stable")[: int(np.count_nonzero(wide > 1e-12 * sides.max(axis=0) ** 4))]
    turned = TURNED[np.argmax(sides[:, order], axis=0)]
    return np.take_along_axis(triples[order], turned, axis=1)


def _motions(clouds: PointClouds, source: Integers, target: Integers, mirror: bool) -> list[Motions]:
    """The motions of triples onto triples; in space, where three points have no handedness, reflections as well."""
    first, second = clouds.source[source], clouds.target[target]
    if clouds.source.shape[1] == 2:
        return [fit_motions(first, second, clouds.scaled, mirror)]
    centre, centre2 = first.mean(axis=1), second.mean(axis=1)
    frame, frame2 = (np.nan_to_num(triangle_frames(one)) for one in (first, second))
    scale = np.ones(len(first))
    if clouds.scaled:
        own, other = (((first - centre[:, None]) ** 2), ((second - centre2[:, None]) ** 2))
        scale = np.sqrt(other.sum(axis=(1, 2)) / own.sum(axis=(1, 2)))
    motions = []
    for kind in (frame2, frame2 * (1.0, 1.0, -1.0))[: 1 + mirror]:
        linear = scale[:, None, None] * kind @ frame.swapaxes(1, 2)
        motions.append(Motions(linear, centre2 - (linear @ centre[:, :, None])[:, :, 0], scale))
    return motions


def label_by_motions(
    clouds: PointClouds, kinds: list[Motions], allowed: Bools | None, minimum: int | None = None
) -> Integers:
    """Distinct labellings (H, n) by motions of triples, of the first of them where a deadline passes.

    ``minimum``: fewest matches; three by default, but if a motion explains more than twice as many points, those that
    explain no more than the triple that names them are of no account.
    """
    motions = concatenate_motions(kinds)
    places, explained = PlaceGrid(clouds, WIDE, allowed), np.zeros(len(motions.scale), np.int64)
    for part in _parts(clouds, len(explained)):
        explained[part] = places.explained(motions.take(part))
    if minimum is None:
        minimum = 3 + int(explained.max(initial=0) > 6)
    motions = motions.take(np.flatnonzero(explained >= minimum))
    labelled = _label_in_parts(
        clouds, len(motions.scale), lambda some: motions.take(some).squares(clouds), WIDE, allowed
    )
    return _distinct_labellings([labelled], minimum)


def _label_in_parts(
    clouds: PointClouds,
    count: int,
    squares: Callable[[slice], tuple[Floats, Floats]],
    gate: float,
    allowed: Bools | None,
) -> Integers:
    """Labellings (H, n) by ``count`` motions, of the first of them where a deadline passes."""
    every = [np.empty((0, len(clouds.source)), np.int64)]
    for part in _parts(clouds, count):
        squared, variance = squares(part)
        deviation = squared / variance
        if allowed is not None:
            deviation[:, ~allowed] = np.inf
        every.append(mutual_nearest(deviation, gate**2))
    return np.concatenate(every)


def _parts(clouds: PointClouds, count: int) -> Iterator[slice]:
    """Parts of ``count`` motions between which the time is looked at, the first of them where a deadline passes."""
    step = max(CELLS // (len(clouds.source) * len(clouds.target)), 1)
    for first in range(0, count, step):
        if first and active_deadline().passed():
            return
        yield slice(first, first + step)


def _distinct_labellings(parts: list[Integers], minimum: int) -> Integers:
    """Distinct labellings with enough matches, those with the most matches first."""
    every = np.concatenate(parts)
    matched = (every >= 0).sum(axis=1)
    every, matched = every[matched >= minimum], matched[matched >= minimum]
    # a random number of each labelling: two of 2⁶⁴ are hardly ever the same by chance
    _, place = np.unique(every @ _keys(every.shape[1]), return_index=True)
    return np.asarray(every[place[np.lexsort((place, -matched[place]))]])


@lru_cache(maxsize=16)
def _keys(n: int) -> Integers:
    """Random numbers (n,), the same for every labelling."""
    return np.random.default_rng(0).integers(-(2**62), 2**62, n, dtype=np.int64)

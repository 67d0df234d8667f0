"""Near symmetries of a body: motions and reflections that map many of its points onto others, as a headset's do.

From some side, a pose and the same pose after such a motion give nearly the same image; after a reflection, the same
pose with reversed depth does. A search that is cut short may find only one of them; the symmetries propose the other.
What repeats itself, as stairs do, is displaced along itself: the motion need not turn anything.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import triangle_frames
from rootmatch.arrays import Bools, Floats, Integers, cache_by_values
from rootmatch.model.bit_rows import choose_bits, clear_bits, pack_words
from rootmatch.problems.noise import mean_deviation
from rootmatch.problems.points import mutual_nearest
from rootmatch.problems.pose_fit.reference_point import body_radius
from rootmatch.samplers.point_sets.motions import fit_motions

TOLERANCE = 0.01
"""Distance between a point's image and another point, over the body's radius, up to which they are the same. A round
value: the radius of a headset is 10 cm, and the halves of the one in benchmarks/tracking.py differ by 0.22 mm."""
DISTINCT = 0.25
"""The same over the distance of neighbours, if that is less: of what is long they are near, and some of its points
nearer than most. A round value."""
ERRORS = 6.0
"""The same in standard deviations of a coordinate of points that were measured, if that is more: of two such points one
in a thousand is farther from the other. A round value."""
MINIMUM, SHARE = 4, 0.25
"""Number of points that have to be mapped, as fewer matches are never trusted; and share of all: with fewer, hardly any
side shows only mapped points. The share is a round value."""
LAW = 6
"""Number of points that have to be mapped by what a body may go on by, or has one after another. A round value."""
ANGLE, APART = 0.2, 4.0
"""Angle, in radians, and distance of where the middle of the body goes, in tolerances, up to which two motions are one.
Round values."""
FACING = 0.8
"""Least cosine between the normals of a mapped point and of the point at its place. A round value."""
WIDE, HIGH = 0.5, 0.25
"""Least side of a triple that is laid onto others, and its least height, over the body's radius; of a long and narrow
body, the height over what is across it. Round values."""
TRIPLES, DRAWN = 256, 4096
"""Most triples that are, and how many are drawn for that. A motion is found by any triple that it maps: a share s³ of
them where it maps a share s of many points. So one that maps half of them is missed with a probability of e⁻³², three
eighths e⁻¹³, and a quarter, the least that counts, e⁻⁴, or e⁻⁸ where its inverse is another, which is asked for too."""
MAX_LAID, COUNTED = 1024, 10_000_000
"""Most pairs of triples whose motions' mapped points are counted, and most pairs of points that are compared for that.
A body that has more has many symmetries, of which those that map most remain."""
MAXIMUM = 12
"""Most motions that are kept: a row that is symmetric about three axes has eleven besides itself that map all of it or
all but an end. A round value."""
ROUGH = 2.0
"""Factor on the distance before a motion is fitted to more than a triple. A round value."""
REFINED = 8
"""Number of motions fitted for each one returned, because the number of mapped points may change."""
ROUNDS = 3
"""Largest number of fits of a motion, each to the points that the previous one maps."""
STEPS, MIN_NEAR = 16, 5e-4
"""Steps of the tolerance in which distances are compared, and the least tolerance over the extent of a body: distances
are up to 2,000 tolerances then, 32,000 steps, and a word of 16 bits holds 32,767."""
MAX_POINTS = 400
"""Number of points beyond which no symmetries are sought. A round value: of 300, it takes up to .8 s, once a body."""


class NearSymmetry(NamedTuple):
    """A motion or reflection x' = R x + t that puts many points of a body onto others."""

    rotation: Floats
    """(3, 3), of determinant −1 for a reflection."""
    shift: Floats
    image: Integers
    """(n,) point at the place of each after the motion, each once; −1 for none."""

    @property
    def mapped_count(self) -> int:
        """Number of points that have an image."""
        return int(np.count_nonzero(self.image >= 0))

    @property
    def moves(self) -> bool:
        """Whether many points that have an image have another one as that: a motion next to none does not."""
        own = np.flatnonzero(self.image >= 0)
        return 4 * int(np.count_nonzero(self.image[own] != own)) > len(own)


def same_point_tolerance(source: Floats) -> float:
    """Distance up to which points (n, 3) of a body are the same.

    Where they are near each other, they are told apart, as far as the words of `STEPS` can.
    """
    minimum = MIN_NEAR * float(np.linalg.norm(np.ptp(source, axis=0)))
    return max(min(TOLERANCE * body_radius(source), float(np.median(neighbour_tolerance(source)))), minimum)


def neighbour_tolerance(points: Floats) -> Floats:
    """Distance (n,) from each of some points (n, 3) within which what lies there is that point and no neighbour."""
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    return np.asarray(DISTINCT * np.partition(distance, 1, axis=1)[:, 1])


def find_symmetries(
    source: Floats,
    normals: Floats | None,
    mirrored: bool = False,
    *,
    covariance: Floats | None = None,
) -> tuple[NearSymmetry, ...]:
    """The near symmetries of a body, those that map most points first; computed once for each body.

    Triples of points, at most `TRIPLES`, are laid onto all triples of the same sides; the points that such a motion
    maps are counted, and it is fitted to them.

    Parameters
    ----------
    source : (n, 3) array
    normals : (n, 3) array, optional
        Outward normals: a point is mapped only onto one that faces the same way, or the opposite way by a reflection,
        as depth is reversed with it; zero if unknown.
    mirrored : bool
        Reflections, with or without a rotation, instead of motions.
    covariance : (n, 3, 3) array, optional
        Of the points, if they were measured.
    """
    if not MINIMUM <= len(source) <= MAX_POINTS:
        return ()
    noise = None if covariance is None else _noise_tolerance(source, covariance)
    return _cache_symmetries(source, normals, mirrored, noise)


@cache_by_values(128)
def _noise_tolerance(source: Floats, covariance: Floats) -> Floats | None:
    """Distance (n,) up to which points are the same by their errors; None if that is no more than without these.

    Then a body has the symmetries of one with exact points, which are asked for as well.
    """
    noise = ERRORS * mean_deviation(covariance)
    return None if (noise <= np.minimum(same_point_tolerance(source), neighbour_tolerance(source))).all() else noise


@cache_by_values(128)
def _cache_symmetries(
    source: Floats, normals: Floats | None, mirrored: bool, noise: Floats | None
) -> tuple[NearSymmetry, ...]:
    """See `find_symmetries`."""
    found = _search_symmetries(_Body.of(source, normals, -1.0 if mirrored else 1.0, noise))
    for one in found:
        for array in one:
            array.setflags(write=False)
    return tuple(found)


class _Body(NamedTuple):
    """A body whose symmetries are sought."""

    source: Floats
    """(n, 3) points."""
    unit: Floats | None
    """(n, 3) unit normals, zero if unknown."""
    sign: float
    """1 for motions, −1 for reflections."""
    distance: Floats
    """(n, n) distances of the points."""
    near: float
    """Distance up to which points are the same."""
    reach: Floats
    """(n,) the same of each point, less where it has near neighbours."""

    @classmethod
    def of(cls, source: Floats, normals: Floats | None, sign: float, noise: Floats | None) -> _Body:
        """A body of points (n, 3) with outward normals (n, 3) of any length, the same up to a noise (n,) at least."""
        unit = None
        if normals is not None:
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            unit = normals / np.where(length > 0.0, length, 1.0)
        distance = np.linalg.norm(source[:, None] - source, axis=2)
        near = same_point_tolerance(source)
        reach = np.minimum(near, neighbour_tolerance(source))
        if noise is not None:
            near, reach = max(near, float(np.median(noise))), np.maximum(reach, noise)
        return cls(source, unit, sign, distance=distance, near=near, reach=reach)

    def is_known_motion(self, found: list[NearSymmetry], one: NearSymmetry) -> bool:
        """Whether a motion is nearly the same as one of those found."""
        rotations, shifts = np.array([known.rotation for known in found]), np.array([known.shift for known in found])
        return len(found) > 0 and bool(self.alike(rotations, shifts, one).any())

    def alike(self, rotations: Floats, shifts: Floats, one: NearSymmetry) -> Bools:
        """Which of some motions (M, 3, 3) and (M, 3) are nearly the same as another."""
        apart = self.source.mean(axis=0) @ (rotations - one.rotation).swapaxes(-2, -1) + shifts - one.shift
        same = (rotations * one.rotation).sum(axis=(-2, -1)) > 1.0 + 2.0 * math.cos(ANGLE)
        return np.asarray(same & (np.linalg.norm(apart, axis=-1) < APART * self.near))


def _search_symmetries(body: _Body) -> list[NearSymmetry]:
    minimum = max(MINIMUM, math.ceil(SHARE * len(body.source)))
    laid = [_align_triples(body, triples) for triples in _choose_triples(body)]
    rotations, shifts = (np.concatenate(one) for one in zip(*laid, strict=True))
    counts = _count_mapped(body, rotations, shifts)
    found: list[NearSymmetry] = []
    for _ in range(REFINED * MAXIMUM):
        enough = sorted([one.mapped_count for one in found], reverse=True)[MAXIMUM - 1 : MAXIMUM]
        if not len(counts) or counts.max() < max([minimum, *enough]):
            break
        k = int(counts.argmax())
        one = _refine_motion(body, rotations[k], shifts[k])
        for other in (one, _refine_motion(body, one.rotation.T, -one.rotation.T @ one.shift)):
            if other.mapped_count >= minimum and other.moves and not body.is_known_motion(found, other):
                found.append(other)
        counts = np.where(body.alike(rotations, shifts, one), 0, counts)
        counts[k] = 0
    found.sort(key=lambda one: -one.mapped_count)
    return found[:MAXIMUM]


def _align_triples(body: _Body, triples: Integers) -> tuple[Floats, Floats]:
    """Motions (M, 3, 3) and (M, 3) of triples (T, 3) onto others of the same sides, without the identity."""
    source, unit, near = body.source, body.unit, body.near
    a, b, c = triples.T
    n = len(source)
    steps = (body.distance * (STEPS / near)).astype(np.int16)
    pairs = np.flatnonzero(_is_same_side(steps, steps[a, b]))
    triple, pair = np.divmod(pairs, n * n)
    k, j = np.divmod(pair, n)
    both = pack_words(_is_same_side(steps, steps[a, c]))[triple, k]
    both &= pack_words(_is_same_side(steps, steps[b, c]))[triple, j]
    itself = np.flatnonzero((k == a[triple]) & (j == b[triple]))
    clear_bits(both, itself, c[triple[itself]])
    row, m = choose_bits(both, min(MAX_LAID, COUNTED // n**2))
    triple = triple[row]
    first, second = (np.column_stack(one) for one in ((a[triple], b[triple], c[triple]), (k[row], j[row], m)))
    frames = triangle_frames(source[first]), triangle_frames(source[second])
    rotations = frames[1] * (1.0, 1.0, body.sign) @ frames[0].swapaxes(1, 2)
    if unit is not None:
        turned = np.einsum("hij,hmj->hmi", rotations, unit[first])
        cosine = body.sign * (turned * unit[second]).sum(axis=2)
        known = unit[first].any(axis=2) & unit[second].any(axis=2)
        facing = ((cosine >= FACING) | ~known).all(axis=1)
        rotations, first, second = rotations[facing], first[facing], second[facing]
    shifts = source[second].mean(axis=1) - np.einsum("hij,hj->hi", rotations, source[first].mean(axis=1))
    return rotations, shifts


def _choose_triples(body: _Body) -> tuple[Integers, Integers]:
    """Random triples (T, 3) of points far apart and not in line, each once, and one about each point, for parts."""
    source = body.source
    n, radius = len(source), body_radius(source)
    drawn = np.random.default_rng(0).integers(0, n, (DRAWN, 3))
    drawn = drawn[(drawn[:, 0] < drawn[:, 1]) & (drawn[:, 1] < drawn[:, 2])]
    _, unique = np.unique(drawn @ (n * n, n, 1), return_index=True)
    drawn = drawn[np.sort(unique)]
    sides, area = _sides_and_areas(source, drawn)
    spread = np.linalg.svd(source - source.mean(axis=0), compute_uv=False)[1:]
    across = min(math.sqrt(2.0 * float(spread @ spread) / n), radius)  # the radius itself of a round body
    fair = (sides.min(axis=0) > WIDE * radius) & (area > HIGH * across * sides.max(axis=0))
    few = min(LAW, n)
    beside = np.argpartition(body.distance, few - 1, axis=1)[:, :few]
    local = np.sort(beside[:, list(itertools.combinations(range(few), 3))], axis=2)
    widest = _sides_and_areas(source, local.reshape(-1, 3))[1].reshape(n, -1).argmax(axis=1)
    local = np.unique(local[np.arange(n), widest], axis=0)
    local = local[_sides_and_areas(source, local)[1] > 0.0]
    return drawn[fair][:TRIPLES], local


def _sides_and_areas(source: Floats, triples: Integers) -> tuple[Floats, Floats]:
    """Sides (3, T) of triples (T, 3) and twice their areas (T,)."""
    a, b, c = source[triples].swapaxes(0, 1)
    sides = np.array([np.linalg.norm(one, axis=1) for one in (b - a, c - a, c - b)])
    return sides, np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _is_same_side(steps: NDArray[np.int16], sides: NDArray[np.int16]) -> Bools:
    """Which of all distances (n, n) are that of a side (T,), as (T, n, n); all in steps."""
    # what is less than the least is a large number without its sign: one comparison instead of two
    return np.asarray((steps - (sides - STEPS)[:, None, None]).view(np.uint16) <= np.uint16(2 * STEPS))


def _count_mapped(body: _Body, rotations: Floats, shifts: Floats) -> Integers:
    """Points (M,) that each motion maps onto others; a coarser distance, as triples alone tell a motion roughly."""
    source, unit = body.source, body.unit
    if not len(rotations):
        return np.empty(0, np.int64)
    centred = (source - source.mean(axis=0)).astype(np.float32)
    moved = (source @ rotations.swapaxes(1, 2) + shifts[:, None] - source.mean(axis=0)).astype(np.float32)
    squared = (moved**2).sum(axis=2)[:, :, None] - 2.0 * moved @ centred.T + (centred**2).sum(axis=1)
    possible = squared < ((ROUGH * body.reach) ** 2).astype(np.float32)
    if unit is not None:
        cosine = body.sign * (unit @ rotations.swapaxes(1, 2)).astype(np.float32) @ unit.T.astype(np.float32)
        possible &= (cosine >= FACING) | _lacks_normal(unit)
    return np.asarray(possible.any(axis=2).sum(axis=1))


def _refine_motion(body: _Body, rotation: Floats, shift: Floats) -> NearSymmetry:
    """A motion fitted to the points that it maps, and again to those that it maps after the fit."""
    found = NearSymmetry(rotation, shift, _map_points(body, rotation, shift, reach=ROUGH * body.reach))
    hand = np.array((1.0, 1.0, body.sign))
    for _ in range(ROUNDS):
        own = np.flatnonzero(found.image >= 0)
        if len(own) < 3:
            break
        # a reflection is a motion of the mirror image
        first, second = body.source[own] * hand, body.source[found.image[own]]
        fitted = fit_motions(first[None], second[None], scaled=False, mirror=False)
        rotation, shift = fitted.linear[0] * hand, fitted.shift[0]
        before, found = found, NearSymmetry(rotation, shift, _map_points(body, rotation, shift, reach=body.reach))
        if np.array_equal(before.image, found.image):
            break
    return found


def _map_points(body: _Body, rotation: Floats, shift: Floats, reach: Floats) -> Integers:
    """The point (n,) at the place of each after a motion, nearest to each other; −1 for none."""
    off = np.linalg.norm((body.source @ rotation.T + shift)[:, None] - body.source, axis=2)
    possible = off < reach
    if body.unit is not None:
        cosine = body.sign * (body.unit @ rotation.T) @ body.unit.T
        possible &= (cosine >= FACING) | _lacks_normal(body.unit)
    return mutual_nearest(np.where(possible, off, np.inf))


def _lacks_normal(unit: Floats) -> Bools:
    """Pairs (n, n) of points of which one has no normal."""
    known = unit.any(axis=1)
    return np.asarray(~np.logical_and.outer(known, known))

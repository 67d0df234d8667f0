"""Pairs of matches about a known place, looked up by their angles: which two points may two detections be.

From a known place the points lie in known directions, so two detections are two points that are as far apart, in angle,
as they are. A sorted table of the angles between points has those side by side. Such a pair tells a rotation, and that
where the other detections are: the rotations come first under which most of them are points too. Catalogues of stars
are searched so.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.explain.known_rotation import MAX_PAIRS
from rootmatch.problems.limits import GATE
from rootmatch.samplers.guided.visibility import MISSED

FIRST, MAX_LOOKED = 2_000, 500_000
"""Pairs of points that are tried at first, then as many again as before, and most of all pairs of detections together.
Round values."""
PARTS, BEST = 4, 4
"""Parts in which the other detections are looked up, after each of which as small a part of the pairs goes on; and how
many do at least, over those asked for. Round values: of a pose with five matches a part has one of the other three."""
RIM = 0.5
"""What a detection at the rim of its gate counts, over one at its middle. A round value."""
BY_CHANCE = 0.01
"""Probability that some direction is that of a point, within the gates of two matches that tell a rotation, up to which
angles are looked up: beyond, the pixels of three tell more than the place. A round value."""
CHANCE = 4.0
"""Standard deviations of what chance has in the best of many thousand pairs. A round value."""
AT_ONCE = 100_000
"""Directions that are looked up between two looks at the time: some 50 ms. A round value."""


class Directions(NamedTuple):
    """Directions from a known place to what may be matched."""

    i: Integers
    """(M,) points of possible matches."""
    j: Integers
    """(M,) their detections."""
    towards: Floats
    """(M, 3) unit vectors in the camera's frame from the place to the point."""
    variance: Floats
    """(M,) of their angles, rad²."""
    of_points: Floats
    """(n, 3) unit vectors to all points in the body's frame."""


class Agreeing(NamedTuple):
    """K pairs of matches whose angle is that of their points, and the rotation by each."""

    first: Integers
    """(K,) numbers of matches."""
    second: Integers
    """(K,)."""
    rotation: Floats
    """(K, 3, 3)."""

    @classmethod
    def of(cls, given: Directions, first: Integers, second: Integers) -> Agreeing:
        """Pairs that agree, with the rotations that turn the bisectors of two directions, and what is across both."""
        turned = _frames(given.towards[first], given.towards[second])
        own = _frames(given.of_points[given.i[first]], given.of_points[given.i[second]])
        return cls(first, second, turned @ own.swapaxes(1, 2))

    def take(self, which: Integers) -> Agreeing:
        """Some of them, in this order."""
        return Agreeing(self.first[which], self.second[which], self.rotation[which])


class _Cones(NamedTuple):
    """The cone in which a detection is seen from the place, whichever point it is."""

    axis: Floats
    """(n', 3)."""
    width: Floats
    """(n',) radians."""
    sigma: Floats
    """(n',) largest standard deviation of a direction in it; infinite for what no point may be."""


class _Table(NamedTuple):
    """Pairs of points by their angle, and where pairs of detections are looked up, in random order."""

    points: Integers
    """(T, 2)."""
    detections: Integers
    """(P, 2)."""
    begin: Integers
    """(P,) first pair of points that is as far apart as those detections, if noise is taken in."""
    end: Integers
    """(P,) the one after the last."""


def search_angle_table(given: Directions, rng: np.random.Generator, *, maximum: int) -> Agreeing | None:
    """At most so many pairs that agree, those first whose rotation explains most; None where a table tells too little.

    That is where any direction is that of some point (`BY_CHANCE`), or a detection that of one in two directions, or
    where more than `MAX_PAIRS` of points are as near each other as two detections, or those leave more than
    `MAX_LOOKED`. Pairs of detections are looked up in random order. Any two matches of a pose lead to it, so that one
    with as many as the best has is missed with a probability that falls with its pairs; below `MISSED` the others need
    not be looked up.
    """
    from scipy.spatial import cKDTree  # slow to import

    match = np.full((len(given.of_points), int(given.j.max(initial=-1)) + 1), -1, np.int64)
    match[given.i, given.j] = np.arange(len(given.i))
    used = np.flatnonzero((match >= 0).any(axis=1))
    if (match >= 0).sum() < len(given.i) or len(used) < 2:
        return None  # a line of sight meets a sphere twice
    cones = _cones(given, match.shape[1])
    shown = np.isfinite(cones.sigma)
    reach = float(np.median((2.0 * GATE * cones.sigma + cones.width)[shown]))
    if 0.25 * len(used) * reach**2 > BY_CHANCE:
        return None
    tree = cKDTree(given.of_points[used])
    table = _table(given, cones, tree, used, rng)
    if table is None:
        return None
    sizes = table.end - table.begin
    sums, last = np.cumsum(sizes), 0
    nothing = np.empty(0, np.int64)
    found, score = Agreeing.of(given, nothing, nothing), np.empty(0)
    while last < len(sizes):
        wanted = max(FIRST, 2 * int(sums[last - 1])) if last else FIRST
        begin, last = last, min(max(int(np.searchsorted(sums, wanted, side="right")), last + 1), len(sizes))
        more = _search_pairs(given, table, match, slice(begin, last))
        best, explained, matched = _rank_by_explained(given, more, tree, cones, maximum=maximum, rng=rng)
        first, second, rotation = (np.concatenate(two) for two in zip(found, more.take(best), strict=True))
        score = np.concatenate([score, explained])
        order = np.argsort(-score, kind="stable")[:maximum]
        found, score = Agreeing(first, second, rotation).take(order), score[order]
        if (1.0 - last / len(sizes)) ** math.comb(matched, 2) <= MISSED:
            break
    return found


def _search_pairs(given: Directions, table: _Table, match: Integers, some: slice) -> Agreeing:
    """Pairs of matches of some pairs of detections, either of which may be either point."""
    end, sizes = table.end[some], (table.end - table.begin)[some]
    i = table.points[np.arange(int(sizes.sum())) + np.repeat(end - np.cumsum(sizes), sizes)]
    j = np.repeat(table.detections[some], sizes, axis=0)
    first = np.concatenate([match[i[:, k], j[:, 0]] for k in (0, 1)])
    second = np.concatenate([match[i[:, k], j[:, 1]] for k in (1, 0)])
    possible = (first >= 0) & (second >= 0)
    return Agreeing.of(given, *select_agreeing(given, first[possible], second[possible]))


def select_agreeing(given: Directions, first: Integers, second: Integers) -> tuple[Integers, Integers]:
    """Those of some pairs (K,), (K,) of matches whose angle is that of their points, and not too small."""
    seen = angle_between(given.towards[first], given.towards[second])
    there = angle_between(given.of_points[given.i[first]], given.of_points[given.i[second]])
    gate = GATE * np.sqrt(given.variance[first] + given.variance[second])
    agrees = (np.abs(seen - there) <= gate) & (there > gate) & (there < math.pi - gate)
    return first[agrees], second[agrees]


def angle_between(one: Floats, other: Floats) -> Floats:
    """Angles (…) between unit directions (…, 3)."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(one, other), axis=-1), (one * other).sum(axis=-1)))


def _cones(given: Directions, n_target: int) -> _Cones:
    axis, sigma, width = np.zeros((n_target, 3)), np.zeros(n_target), np.zeros(n_target)
    np.add.at(axis, given.j, given.towards)
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
    np.maximum.at(sigma, given.j, np.sqrt(given.variance))
    np.maximum.at(width, given.j, angle_between(given.towards, axis[given.j]))
    return _Cones(axis, width, np.where(np.bincount(given.j, minlength=n_target) > 0, sigma, np.inf))


def _table(given: Directions, cones: _Cones, tree: Any, used: Integers, rng: np.random.Generator) -> _Table | None:
    """The table of the points that are used; None where it tells too little."""
    shown = np.flatnonzero(np.isfinite(cones.sigma))
    pairs = rng.permutation(shown[np.column_stack(np.triu_indices(len(shown), 1))])
    if not len(pairs):
        return None
    seen = angle_between(cones.axis[pairs[:, 0]], cones.axis[pairs[:, 1]])
    reach = GATE * np.linalg.norm(cones.sigma[pairs], axis=1) + cones.width[pairs].sum(axis=1)
    chord = 2.0 * math.sin(0.5 * min(float((seen + reach).max()), math.pi))
    if tree.count_neighbors(tree, chord) > 2 * MAX_PAIRS + len(used):
        return None
    points = used[tree.query_pairs(chord, output_type="ndarray")]
    angles = angle_between(given.of_points[points[:, 0]], given.of_points[points[:, 1]])
    order = np.argsort(angles)
    begin, end = (np.searchsorted(angles[order], seen + way * reach) for way in (-1.0, 1.0))
    if (end - begin).sum() > MAX_LOOKED:
        return None
    return _Table(points[order], pairs, begin, end)


def _rank_by_explained(
    given: Directions, found: Agreeing, tree: Any, cones: _Cones, *, maximum: int, rng: np.random.Generator
) -> tuple[Integers, Floats, int]:
    """At most so many of the pairs, those first under whose rotation most of the other detections are points.

    The others are looked up part by part. After each only the better of the pairs go on: a pose has many pairs. With
    what tells for each, and how many matches the best has beyond those that chance has.
    """
    shown = rng.permutation(np.flatnonzero(np.isfinite(cones.sigma)))
    count = len(found.first)
    kept, tally, done = np.arange(count), np.zeros((count, 2, 2)), 0
    offset = rng.integers(0, len(shown), count)
    while done < len(shown):
        last = min(done + math.ceil(len(shown) / PARTS), len(shown))
        size = AT_ONCE // (last - done) + 1
        for start in range(0, len(kept), size):
            checkpoint()
            some = kept[start : start + size]
            looked = shown[(offset[some, None] + np.arange(done, last)) % len(shown)]
            own = np.column_stack([given.j[found.first[some]], given.j[found.second[some]]])
            tally[some] += _hits(tree, cones, own, looked, found.rotation[some])
        kept = kept[np.argsort(-_beyond_chance(tally[kept])[:, 0], kind="stable")]
        done, kept = last, kept[: max(len(kept) // PARTS, BEST * maximum)]
    kept = kept[:maximum]
    sure = _beyond_chance(tally[kept])
    return kept, sure[:, 0], 2 + max(int(sure[0, 1]), 0) if len(kept) else 0


def _beyond_chance(tally: Floats) -> Floats:
    """What is beyond chance (K, 2), by means and variances (K, 2, 2) that chance has subtracted and left."""
    return np.asarray(tally[:, 0] - CHANCE * np.sqrt(tally[:, 1]))


def _hits(tree: Any, cones: _Cones, own: Integers, looked: Integers, rotation: Floats) -> Floats:
    """What tells that some detections (K, L) are points under rotations (K, 3, 3) by pairs (K, 2): (K, 2, 2).

    That is how unlikely those are by chance that are points, less at rims of gates, and how many they are; each less
    what chance has on average, and its variance by chance. An error of a pair turns the other directions the more the
    nearer its two are.
    """
    a, b = cones.axis[own[:, 0]], cones.axis[own[:, 1]]
    middle = (a + b) / np.linalg.norm(a + b, axis=1, keepdims=True)
    lever = 0.5 + angle_between(cones.axis[looked], middle[:, None]) / angle_between(a, b)[:, None]
    of_pair = GATE * np.linalg.norm(cones.sigma[own], axis=1) + cones.width[own].sum(axis=1)
    gate = of_pair[:, None] * lever + GATE * cones.sigma[looked] + cones.width[looked]
    away, _ = tree.query(cones.axis[looked] @ rotation, distance_upper_bound=float(gate.max()))
    others = (looked != own[:, :1]) & (looked != own[:, 1:])
    chance = np.clip(0.25 * tree.n * gate**2, 1e-300, 1.0)
    hit = (away <= gate) & others
    worth = -np.log(chance)
    chance *= others
    gain = np.where(hit, (1.0 - (1.0 - RIM) * np.minimum(away / gate, 1.0) ** 2) * worth, 0.0)
    of_gain = gain - 0.5 * (1.0 + RIM) * chance * worth, (1.0 + RIM + RIM**2) / 3.0 * chance * worth**2
    of_hits = hit - chance, chance
    return np.stack([np.stack(two, axis=2).sum(axis=1) for two in zip(of_gain, of_hits, strict=True)], axis=1)


def _frames(one: Floats, other: Floats) -> Floats:
    """Rotations (K, 3, 3) whose columns are the bisectors of two unit directions, and across both."""
    frame = np.stack([one + other, one - other, np.cross(other, one)], axis=2)
    return np.asarray(frame / np.linalg.norm(frame, axis=1, keepdims=True))

"""Rivals of a hypothesis: poses that explain as much, with its detections as other points, or with other detections.

An object that looks like itself has the former, two copies of one object have the latter. Few detections are tried as
images, in every arrangement, so this takes a fraction of what the search took.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import Pace
from rootmatch.hypergraph.enumeration import target_arrangements
from rootmatch.samplers.guided import batches
from rootmatch.samplers.guided.minimal_sets import LARGEST_WAVE
from rootmatch.samplers.guided.sequential_test import PreparedSets
from rootmatch.samplers.guided.visibility import LOST_OF_ALL, MISSED

if TYPE_CHECKING:
    from rootmatch.samplers.guided.search import Search

SAME = 0.7
"""Fraction of the best hypothesis's detections that a rival explains at least, where normals tell what is visible, or
with other detections. Of ten stretched copies that were trusted beside the object itself six showed a point or three
more than that (`benchmarks/adversary.py`, seeds from 1000)."""
RIVAL, LACKS = 0.9, 3
"""Fraction of the detections of the best hypothesis that a rival, as probable as it is, explains at least; and most
detections that it may lack, however many there are: of a hundred, ten fewer are never as probable."""
LITTLE, CROWD = 3_000_000, 1_000
"""Evaluations that may always be spent on other detections, some 30 ms, and how many of those are a crowd."""
RIVAL_MISSED = 0.08
"""Probability of having missed such a rival at which none is looked for any more, where all points are seen: two
minimal sets in every arrangement of those detections. Of an object that shows a k-th of its points, its k-th power:
with less of it, four in six shuffles of a headset without normals were another side; `tests/test_guided.py` has such
objects."""
RIVAL_RATIO = 0.25
"""Fraction of the likelihood ratio of the best hypothesis, in the same sequential test, that a rival has at least to be
verified: less than of the evidence, as a minimal set may predict worse than another."""


def try_rivals(search: Search) -> None:
    """Try minimal sets until no rival of the strongest hypothesis can well have been missed.

    Copies are rare: a crowd of other detections is worth a search for them as long as what came before, which does not
    count if that ends it.
    """
    best = search._clustered()[2].best[0]
    own = np.sort(best[best >= 0])
    search.missed = search._missed_among(own, len(own), known=best)
    search.budget = min(search.budget, 2 * search.evaluated + LITTLE)
    free = np.ones(search.n_target, np.bool_)
    free[own] = False
    (rest,) = np.nonzero(free)
    if max(fewest(len(own), SAME), search.minimal + 1) <= len(rest) <= CROWD and not search._spent():
        missed = search._missed_among(rest, len(own))
        if not search._spent():
            search.missed = max(search.missed, missed)


def fewest(matched: int, share: float) -> float:
    """Detections that a rival of a hypothesis with so many explains at least: this share of them, and nearly all.

    With the same detections it has to be as probable. Elsewhere it may be another thing, of which less is seen.
    """
    return max(share * matched, matched - LACKS)


def missed_among(
    search: Search, images: NDArray[np.int64], matched: int, known: NDArray[np.int64] | None = None
) -> float:
    """Probability of having missed a rival among some detections, after all minimal sets with them that it takes.

    Of a hypothesis with so many matches; ``known`` (n,) is its assignment if the detections are its own.
    """
    arrangements = target_arrangements(len(images), search.minimal - 1)
    tried, pace = search._tried(), Pace(search.deadline, batches.CHUNKS)
    least = max(search.minimal + 1, math.ceil(SAME * matched))
    # a set is met if a rival, which explains nearly as many detections, explains all of its points
    explained = fewest(matched, SAME if known is None else RIVAL)
    met = min((explained / search.n) ** search.minimal, 0.999) * (1.0 if known is not None else 1.0 - LOST_OF_ALL)
    # the more of the object is hidden, the more poses show another side of it, and the fewer sets are wide in each
    hidden = search.n / matched if known is not None else 1.0
    enough = RIVAL_MISSED**hidden if tried is None else MISSED
    done, wanted, missed = 0, math.ceil(math.log(enough) / math.log1p(-met)), 1.0
    if wanted == 0:
        return 0.0
    for sets in _sets(search, len(arrangements), wanted=wanted if tried is None else 0):
        some = sets if tried is not None else sets.first(wanted - done)
        first, tasks = 0, len(some.points) * len(arrangements)
        most = max(batches.LARGEST // len(images), batches.CHUNKS)
        while first < tasks and (block := pace.block(min(tasks - first, most))):
            last = first + block
            search._try(some, search._test(0), arrangements, first=first, last=last, images=images, known=known)
            first = last
            if search._spent():
                break
        if first == tasks:
            done += len(some.points)
            if tried is not None:
                tried.add(some.points)
        missed = (1.0 - met) ** done if tried is None else tried.missed(least)
        if missed <= enough or search._spent():
            return missed
    return 0.0


def _sets(search: Search, arrangements: int, wanted: int) -> Iterator[PreparedSets]:
    """Waves of minimal sets; where so many are wanted, whichever, those that the search began with are among the first.

    These are tried together with further ones: another wave takes as long as its kernel. All are wide ones again: those
    that the search has left by then are narrow, and with them the rivals of a headset were missed.
    """
    waves = search._waves()
    if wanted and search.first_sets is not None:
        first = search.first_sets._replace(offset=np.zeros_like(search.first_sets.offset))
        lacking = min(wanted, LARGEST_WAVE) - len(first.points)
        points = _joined(waves, lacking)
        if len(points):
            further = search._prepared(points, arrangements)
            first = PreparedSets(*(np.concatenate(pair) for pair in zip(first, further, strict=True)))
        yield first
    for points in waves:
        yield search._prepared(points, arrangements)


def _joined(waves: Iterator[NDArray[np.int64]], count: int) -> NDArray[np.int64]:
    """The first ``count`` minimal sets of some waves, all where there are fewer."""
    found: list[NDArray[np.int64]] = []
    while count > sum(map(len, found)) and (wave := next(waves, None)) is not None:
        found.append(wave)
    return np.concatenate(found)[:count] if found else np.empty((0, 0), np.int64)

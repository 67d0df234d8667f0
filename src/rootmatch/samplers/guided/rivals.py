"""Rivals of a hypothesis: poses that explain as much, with its detections as other points, or with other detections.

An object that looks like itself has the former, two copies of one object have the latter. Few detections are tried as
images, in every arrangement, so this takes a fraction of what the search took.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rootmatch.arrays import Bools, Integers
from rootmatch.deadline import Pace
from rootmatch.hypergraph.enumeration import target_arrangements
from rootmatch.samplers.guided import batches
from rootmatch.samplers.guided.minimal_sets import LARGEST_WAVE, width
from rootmatch.samplers.guided.visibility import LOST_OF_ALL, MISSED, TriedSets, sets_within_views, views_of_parts

if TYPE_CHECKING:
    from rootmatch.samplers.guided.search import Search
    from rootmatch.samplers.guided.survivors import Survivors

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
"""Probability of having missed a rival at which none is looked for any more: one elsewhere that shows far less than
the best, and any where no normals tell what is visible: two minimal sets in every arrangement of those detections,
where all points are seen. `tests/test_guided.py` has objects that show less of them."""
VAIN = 0.75
"""Probability that a set leads to nothing, as those of the known pose tell it, beyond which no more are tried. A round
value."""
RIVALS_KEPT, RIVALS_VERIFIED = 512, 64
"""Rivals that survive a batch and are kept, and how many of them are verified at most, one for each pose. Round values.
"""
DRAWN, TAKEN = 64, 8
"""Sets that are drawn at once, of as many views, and how many of them are taken. Round values."""
EXISTS = 0.1
"""Probability that there is a rival of what does not look like itself in any pose that was met. A round value."""
RIVAL_RATIO = 0.25
"""Fraction of the likelihood ratio of the best hypothesis, in the same sequential test, that a rival has at least to be
verified: less than of the evidence, as a minimal set may predict worse than another."""


def try_rivals(search: Search) -> None:
    """Try minimal sets until no rival of the strongest hypothesis can well have been missed."""
    best = search._cluster_hypotheses()[2].best[0]
    own = np.sort(best[best >= 0])
    search.missed = search._missed_among(own, min_own_detections(search, len(own)), known=best)
    search.missed = max(search.missed, try_elsewhere(search))


def try_elsewhere(search: Search) -> float:
    """Try other detections than those of the strongest hypothesis; the probability of having missed a rival there.

    Copies are rare: a crowd of other detections is worth a search for them as long as what came before, which does not
    count if that ends it.
    """
    every, free = search._cluster_hypotheses()[2].best, np.ones(search.n_target, np.bool_)
    if not len(every):
        return 0.0
    search.budget, best = min(search.budget, 2 * search.evaluated + LITTLE), every[0]
    free[best[best >= 0]] = False
    (rest,) = np.nonzero(free)
    # none shows more detections than there are
    shown = [count for count in min_other_detections(search, int((best >= 0).sum())) if count <= len(rest)]
    if not shown or len(rest) > CROWD or search._is_spent():
        return 0.0
    missed = search._missed_among(rest, shown)
    return 0.0 if search._is_spent() else missed


def allowed_pairs(search: Search, images: Integers) -> Bools:
    """The possible correspondences (n, n') with some detections."""
    mask = np.zeros(search.shape, np.bool_)
    mask[:, images] = True
    return mask & search.allowed if search.allowed.size else mask


def min_own_detections(search: Search, matched: int) -> tuple[int]:
    """Detections of a hypothesis with so many that a rival explains at least: it has to be as probable."""
    share = SAME * matched if search.normals and search.single else max(RIVAL * matched, matched - LACKS)
    return (max(search.minimal + 1, math.ceil(share)),)


def min_other_detections(search: Search, matched: int) -> tuple[int, int]:
    """Other detections that a rival of a hypothesis with so many explains at least.

    The first number is of one that shows nearly as much, which must not be missed. The second is of one that chance
    does not explain: how much a copy shows does not tell which of the two is asked for, but the prior of it is low.
    """
    as_much = max(search.minimal + 1, math.ceil(max(SAME * matched, matched - LACKS)))
    return as_much, min(as_much, max(2 * search.minimal, search.fewest))


def rival_miss_probability(
    search: Search, images: Integers, shown: Sequence[int], known: Integers | None = None
) -> float:
    """Probability of having missed a rival among some detections, after all minimal sets with them that it takes.

    It explains ``shown[0]`` of them at least; if there is a second number, one that explains so many is hardly missed
    either. ``known`` (n,) is the hypothesis if the detections are its own.
    """
    arrangements = target_arrangements(len(images), search.minimal - 1)
    tried, pace, wanted = search._tried(), Pace(search.deadline, batches.CHUNKS), False
    if tried is None:
        # a rival explains so many detections, of any points
        tried, wanted = TriedSets(partial(views_of_parts, positions=search.positions), LOST_OF_ALL), True
    minimum = shown[-1]
    test = search._test(0, minimum)
    for points in _rival_waves(search, tried, shown) if wanted else search._waves():
        sets, met = search._prepare_sets(points, len(arrangements)), 0
        first, tasks = 0, len(points) * len(arrangements)
        while first < tasks and (block := pace.block(min(tasks - first, _affordable_tasks(search, images, known)))):
            last = first + block
            met += search._try(sets, test, arrangements, first=first, last=last, images=images, known=known)
            first = last
            if search._is_spent():
                break
        if first == tasks:
            tried.add(points)
            if wanted and known is not None:
                tried.learn(int((known[points] >= 0).all(axis=1).sum()), met)
        missed = tried.missed(shown[0])
        enough = missed <= MISSED or (wanted and missed <= RIVAL_MISSED and not _looks_like_itself(search))
        enough = enough and (len(shown) == 1 or tried.missed(minimum) <= RIVAL_MISSED)
        if enough or search._is_spent() or (wanted and tried.lost > VAIN):
            return missed
    return tried.missed(shown[0]) if wanted else 0.0


def _affordable_tasks(search: Search, images: Integers, known: Integers | None) -> int:
    """Tasks until the next look at what was spent: elsewhere no more than the budget has left, as sets cost so far."""
    left = batches.LARGEST
    if known is None:
        left = min(left, int((search.budget - search.evaluated) * search.solved / max(search.evaluated, 1)))
    return max(left // len(images), batches.CHUNKS)


def verify_rivals(search: Search, found: Survivors, known: Integers | None) -> int:
    """Verify the survivors of a batch one by one, the strongest first, that none of those before explains.

    What looks like itself has many rivals, each met by many sets. Of a ``known`` assignment (n,) only those are rivals
    that may have another pose. Returns how many sets have met that one again.
    """
    met = 0
    if known is not None and len(found.ratios):
        met, found = found.met(known), found.rivals_of(known, RIVAL_RATIO)
    for _ in range(RIVALS_VERIFIED):
        if not len(found.ratios):
            break
        before = len(search.hypotheses)
        search._verify(found.points[:1], found.images[:1])
        found = found.take(slice(1, None))
        if len(search.hypotheses) > before:
            found = found.without_assignment(search.hypotheses[-1].best[0])
    return met


def missed_rival_probability(search: Search, missed: float) -> float:
    """Probability that there is a rival that a search has missed, by the one of having missed it if there is one."""
    return missed if _looks_like_itself(search) else EXISTS * missed


def _looks_like_itself(search: Search) -> bool:
    """Whether another pose than that of the best hypothesis is beyond chance."""
    hypotheses = search._cluster_hypotheses()[2]
    beyond = hypotheses.evidence > search._false_alarm_level()
    return bool((beyond & hypotheses.differs_from_first()).any())


def _rival_waves(search: Search, tried: TriedSets, shown: Sequence[int]) -> Iterator[Integers]:
    """Waves of few minimal sets that miss hardly any pose which shows as many points as `rival_miss_probability` asks.

    The widest sets are often of the same few points: where one of these is hidden, all of them fail. So sets are drawn
    from the views that were met least often, and taken by width times what they cover that those before them do not.
    """
    rng, size = np.random.default_rng([search.n, shown[-1]]), search.minimal
    for minimum, enough in (*((count, RIVAL_MISSED) for count in reversed(shown)), (shown[0], MISSED)):
        views = tried.views(minimum)
        while (needed := tried.unmet(minimum)).mean() > enough:
            wave = list[Integers]()
            while len(wave) < LARGEST_WAVE and needed.mean() > enough:
                if len(wave) % TAKEN == 0:
                    places = rng.random((DRAWN, search.n)) + ~views[np.argpartition(-needed, DRAWN)[:DRAWN]]
                    sets = np.sort(np.argpartition(places, size, axis=1)[:, :size], axis=1)
                    covers, wide = sets_within_views(sets, views).astype(np.float32), width(search.positions, sets)
                best = int((wide * (needed @ covers)).argmax())
                wave.append(sets[best])
                needed *= 1.0 - (1.0 - tried.lost) * covers[:, best]
            yield np.array(wave)

"""Clustering of hypotheses that match the same points, and the hyper-edges among each cluster's correspondences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.jit.decorators import driver
from rootmatch.jit.internal import internal_function

WORD = 64
"""Clusters per word of the membership mask."""


SHARED = 0.5
"""Fraction of the correspondences of the smaller of two hypotheses that makes them one."""
WEAK = 0.5
"""Fraction of the leader's evidence below which a hypothesis adds no candidates: it predicts too vaguely."""
CANDIDATES = 6
"""Detections that a cluster keeps for one source point."""


def cluster(evidence: Floats, best: Integers, candidates: Integers, maximum: int) -> tuple[Integers, Integers]:
    """Cluster the hypotheses that share correspondences with a stronger one, the leader of the cluster.

    Parameters
    ----------
    evidence : (K,) array
        Descending.
    best : (K, n) int64 array
    candidates : (K, n, c) int64 array
    maximum : int
        Most clusters.

    Returns
    -------
    leaders : (G,) int64 array
        The strongest hypothesis of each cluster.
    lists : (G, n, c) int64 array
        Candidates of each cluster: those of its leader, then of the others; −1 for none.
    """
    maximum = min(maximum, len(best))
    leaders, size = np.empty(maximum, np.int64), np.empty(len(best), np.int64)
    matched = np.empty(best.shape[1], np.int64)
    lists = np.empty((maximum, best.shape[1], CANDIDATES), np.int64)
    made = _cluster(evidence, best, candidates, SHARED, WEAK, size, matched, leaders, lists)
    return leaders[:made], lists[:made]


@driver(nogil=True)
def _cluster(evidence, best, candidates, min_shared, weak, size, matched, leaders, lists):  # type: ignore[no-untyped-def]
    """Fill in leaders and lists; how many there are. ``size`` (K,) and ``matched`` (n,) are scratch."""
    n, places = best.shape[1], lists.shape[2]
    made = 0
    for q in range(best.shape[0]):
        count = 0
        for d in range(n):
            matched[count] = d
            count += best[q, d] >= 0
        size[q] = count
        home = -1
        for g in range(made):
            leader = leaders[g]
            shared = 0
            for place in range(count):
                shared += best[q, matched[place]] == best[leader, matched[place]]
            fewer = count if count < size[leader] else size[leader]
            if shared >= min_shared * fewer:
                home = g
                break
        if home < 0:
            if made == leaders.size:
                continue
            home = made
            leaders[home] = q
            made += 1
            for d in range(n):
                for place in range(places):
                    lists[home, d, place] = -1
        elif evidence[q] < weak * evidence[leaders[home]]:
            continue
        for d in range(n):
            for c in range(candidates.shape[2]):
                k = candidates[q, d, c]
                if k < 0:
                    break
                for place in range(places):
                    if lists[home, d, place] == k:
                        break
                    if lists[home, d, place] < 0:
                        lists[home, d, place] = k
                        break
    return made


def membership(lists: Integers, n_target: int) -> NDArray[np.uint64]:
    """Which clusters hold each correspondence: bits (n, n', words)."""
    mask = np.zeros((lists.shape[1], n_target, (len(lists) + WORD - 1) // WORD), np.uint64)
    g, d, place = np.nonzero(lists >= 0)
    bits = np.left_shift(np.uint64(1), (g % WORD).astype(np.uint64))
    np.bitwise_or.at(mask, (d, lists[g, d, place], g // WORD), bits)
    return mask


@driver()
def candidate_hyperedges(lists, mask, subsets, source, target, counts):  # type: ignore[no-untyped-def]
    """Hyper-edges over given source points among the candidates of any one cluster, each once, cluster by cluster.

    Parameters
    ----------
    lists : (G, n, LIST) int64 array
    mask : (n, n', words) uint64 array
    subsets : (S, d) int64 array
    source, target : (E, d) int64 arrays
        Filled as far as they go.
    counts : (G,) int64 array
        Filled with how many there are in each cluster.
    """
    order = subsets.shape[1]
    place = np.empty(order, np.int64)
    count = 0
    for g in range(lists.shape[0]):
        before = count
        for s in range(subsets.shape[0]):
            possible = True
            for p in range(order):
                place[p] = 0
                possible = possible and lists[g, subsets[s, p], 0] >= 0
            while possible:
                if _is_first_occurrence(lists, mask, subsets, place, s, g):
                    if count < source.shape[0]:
                        for p in range(order):
                            source[count, p] = subsets[s, p]
                            target[count, p] = lists[g, subsets[s, p], place[p]]
                    count += 1
                # the next combination, the last point's candidate changing fastest
                p = order - 1
                while p >= 0:
                    place[p] += 1
                    if place[p] < lists.shape[2] and lists[g, subsets[s, p], place[p]] >= 0:
                        break
                    place[p] = 0
                    p -= 1
                possible = p >= 0
        counts[g] = count - before


@internal_function()
def _is_first_occurrence(lists, mask, subsets, place, s, g):  # type: ignore[no-untyped-def]
    """Whether the detections are distinct and no earlier cluster holds all the correspondences."""
    order = subsets.shape[1]
    for p in range(order):
        k = lists[g, subsets[s, p], place[p]]
        for q in range(p):
            if lists[g, subsets[s, q], place[q]] == k:
                return False
    for word in range(g // WORD + 1):
        common = np.uint64(0xFFFFFFFFFFFFFFFF)
        for p in range(order):
            i = subsets[s, p]
            common &= mask[i, lists[g, i, place[p]], word]
        if word == g // WORD:
            common &= (np.uint64(1) << np.uint64(g % WORD)) - np.uint64(1)
        if common != 0:
            return False
    return True

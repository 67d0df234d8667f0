"""Rivals of a hypothesis: whether its detections could as well be other points, as of an object that looks like itself.

Only these detections are tried as images, in every arrangement, so this takes a fraction of what the search took.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import Pace
from rootmatch.hypergraph.enumeration import target_arrangements
from rootmatch.samplers.guided.few_detections import FewDetections
from rootmatch.samplers.guided.sequential_test import PreparedSets

if TYPE_CHECKING:
    from rootmatch.samplers.guided.search import Search


def try_rivals(search: Search) -> None:
    """Try minimal sets with the detections of the strongest hypothesis until no rival can well have been missed."""
    options, best = search.options, search._clustered()[2].best[0]
    few = FewDetections.of(search.tables, search.grid, search.allowed, best)
    images = few.images
    arrangements = target_arrangements(len(images), search.minimal - 1)
    tried, pace = search._tried(), Pace(search.deadline, options.batches.chunks)
    least = max(search.minimal + 1, math.ceil(options.visibility.rival * len(images)))
    # a set is met if a rival, which explains nearly as many detections, explains all of its points
    fewest = max(options.refinement.rival * len(images), len(images) - options.refinement.rival_lacks)
    met = min((fewest / search.n) ** search.minimal, 0.999)
    # the more of the object is hidden, the more poses show another side of it, and the fewer sets are wide in each
    hidden = search.n / len(images)
    enough = options.refinement.rival_missed**hidden if tried is None else options.visibility.missed
    done, wanted = 0, math.ceil(math.log(enough) / math.log1p(-met))
    if wanted == 0:
        search.missed = 0.0
        return
    for sets in _sets(search, len(arrangements), wanted=wanted if tried is None else 0):
        some = sets if tried is not None else sets.first(wanted - done)
        first, tasks = 0, len(some.points) * len(arrangements)
        while first < tasks and (block := pace.block(tasks - first)):
            search._try(some, search._test(0), arrangements, first=first, last=first + block, among=few)
            first += block
        if first == tasks:
            done += len(some.points)
            if tried is not None:
                tried.add(some.points)
        search.missed = (1.0 - met) ** done if tried is None else tried.missed(least)
        if search.missed <= enough or search._spent():
            return
    search.missed = 0.0


def _sets(search: Search, arrangements: int, wanted: int) -> Iterator[PreparedSets]:
    """Waves of minimal sets; where so many are wanted, whichever, those that the search began with are among the first.

    These are tried together with further ones: another wave takes as long as its kernel. All are wide ones again: those
    that the search has left by then are narrow, and with them the rivals of a headset were missed.
    """
    waves = search._waves()
    if wanted and search.first_sets is not None:
        first = search.first_sets._replace(offset=np.zeros_like(search.first_sets.offset))
        lacking = min(wanted, search.options.sets.largest_wave) - len(first.points)
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

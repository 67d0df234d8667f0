"""The guided search of a camera of unknown focal length: the search of a known camera, at each of some focal lengths.

What all of them find is judged as one search: a hypothesis has to be beyond what chance reaches in all tests together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.guided.candidate_hyperedges import sample_clusters
from rootmatch.samplers.guided.near_pairs import PairSearch
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.rivals import RIVAL_MISSED, missed_rival_probability
from rootmatch.samplers.limits import LIMITS

SEARCHED, RESERVE = 0.6, 0.3
"""Share of the time left at a deadline that all searches may take, and seconds that suffice for the hyper-edges."""
LONGER = 4
"""Factor on the budget of a search that goes on. A round value."""
NAMED = 64
"""Most assignments that are handed on to be fitted. A round value."""

JOINED = 512
"""Strongest hypotheses of all searches together that are clustered: a few for each assignment. A round value."""


def search_focal_lengths(task: SamplingTask, tables: Callable[[], list[Any]], options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that poses at all focal lengths name; see `Guided`.

    Searches go on until one has found something and no other can well have missed as good a pose.

    ``tables``: those of a camera of each focal length, whose minimal sets are one point smaller.
    """
    deadline = task.deadline.part(SEARCHED, RESERVE).at_most(options.max_seconds)
    few = replace(options, hypotheses=min(options.hypotheses, NAMED))
    tasks = [replace(task, tables=one, order=task.order - 1, progress=None) for one in tables()]
    # the usual focal lengths, in the middle, come first: what is found ends the other searches early
    tasks = [tasks[k] for k in sorted(range(len(tasks)), key=lambda k: abs(k - len(tasks) // 2))]
    searches = list[PairSearch]()
    budget, spent = max(min(LIMITS.quick, options.budget // len(tasks)), 1), 0
    going, found = list(range(len(tasks))), None
    while going:
        for k in going:
            if k == len(searches):
                searches.append(PairSearch(tasks[k], few, deadline))
            search, before = searches[k], searches[k].evaluated
            search.budget, search.best = before + budget, found
            with deadline.within():
                search.run()
            spent += search.evaluated - before
            if found is None and search.strongest > search._false_alarm_level() + math.log(len(tasks)):
                found = search.best  # beyond what chance reaches in all of them
            if task.progress is not None:
                task.progress(min(spent, options.budget), options.budget)
        whole = Together(searches)
        found = whole.best if whole.found else None
        going = [k for k in going if whole.may_miss(searches[k])]
        budget *= LONGER
        if deadline.passed() or spent + len(going) * budget > options.budget:
            break
    if found is None:
        with deadline.within():
            for search in searches:
                search.refine()
        whole = Together(searches)
    if task.progress is not None:
        task.progress(options.budget, options.budget)
    return sample_clusters(
        task, whole.first.clusters, few, whole.first.rng, spent,
        deadline=task.deadline,
        conclusive=whole.found,
        assignments=whole.first.assignments(),
        missed=missed_rival_probability(whole.first, max(whole.missed(search) for search in searches)),
    )  # fmt: skip


class Together:
    """Several searches as one: the first of them gets copies of what all have tested and found."""

    def __init__(self, searches: list[PairSearch]) -> None:
        self.first = first = copy(searches[0])
        every = [batch for search in searches for batch in search.hypotheses]
        evidence = sorted((value for batch in every for value in batch.evidence.tolist()), reverse=True)
        minimum = evidence[:JOINED][-1] if evidence else 0.0
        first.hypotheses = [batch.take(batch.evidence >= minimum) for batch in every]
        first.tested = sum(search.tested for search in searches)
        first._cluster_hypotheses()
        (joined,) = first.hypotheses
        self.found = float(joined.evidence.max(initial=0.0)) > first._false_alarm_level()
        """Whether a hypothesis is beyond what chance reaches in all tests together."""
        self.best = joined.best[0] if len(joined.best) else np.full(first.n, -1)
        """Assignment (n,) of the strongest hypothesis."""

    def missed(self, search: PairSearch) -> float:
        """Probability that one of the searches has missed a pose with as many matches as the best one of all."""
        if search.conclusive or search.missed == 0.0:
            return search.missed
        return search.miss_probability(self.best)

    def may_miss(self, search: PairSearch) -> bool:
        """Whether one of the searches is worth going on with: it has not ended by itself, and may have missed one."""
        ended = search.conclusive or search.missed == 0.0
        return not ended and (not self.found or self.missed(search) > RIVAL_MISSED)

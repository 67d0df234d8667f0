"""The guided search of a camera of unknown focal length: the search of a known camera, at each of some focal lengths.

What all of them find is judged as one search: a hypothesis has to be beyond what chance reaches in all tests together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.guided.candidate_hyperedges import sampled_among
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.visibility import missed_at_random
from rootmatch.samplers.limits import LIMITS

SEARCHED, RESERVE = 0.6, 0.3
"""Share of the time left at a deadline that all searches may take, and seconds that suffice for the hyper-edges."""
LONGER = 8
"""Factor on the budget of each search if none has found anything. A round value."""
NAMED = 64
"""Most assignments that are handed on to be fitted. A round value."""


def focal_tensor(task: SamplingTask, tables: Callable[[], list[Any]], options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that poses at all focal lengths name; see `Guided`.

    ``tables``: those of a camera of each focal length, whose minimal sets are one point smaller.
    """
    deadline, every = task.deadline.part(SEARCHED, RESERVE), tables()
    budget, spent = min(LIMITS.quick, options.budget // len(every)), 0
    few = replace(options, hypotheses=min(options.hypotheses, NAMED))
    while True:
        searches = []
        for number, one in enumerate(every):
            known = replace(task, tables=one, order=task.order - 1, progress=None)
            search = Search(known, replace(few, budget=max(budget, 1)), deadline)
            with deadline.within():
                search.run()
                search.refine()
            searches.append(search)
            if task.progress is not None:
                task.progress(number + 1, len(every))
        spent += sum(search.evaluated for search in searches)
        whole = _together(searches)
        conclusive = bool(whole.hypotheses) and whole.hypotheses[0].evidence[0] > whole._false_alarm_level()
        budget *= LONGER
        done = all(search.evaluated < search.budget for search in searches)
        if conclusive or done or deadline.passed() or spent + len(every) * budget > options.budget:
            break
    return sampled_among(
        task, whole.clusters, few, whole.rng, spent,
        later=task.later and bool(whole.hypotheses) and not task.deadline.is_set,
        deadline=task.deadline,
        conclusive=conclusive,
        assignments=whole.assignments(),
        missed=max(_missed(search, whole) for search in searches),
    )  # fmt: skip


def _together(searches: list[Search]) -> Search:
    """The first of several searches with what all of them tested and found."""
    whole = searches[0]
    whole.hypotheses = [batch for search in searches for batch in search.hypotheses]
    whole.tested = sum(search.tested for search in searches)
    whole._clustered()
    return whole


def _missed(search: Search, whole: Search) -> float:
    """Probability that one of the searches has missed a pose with as many matches as the best one of all."""
    if search.conclusive or search.missed == 0.0:
        return search.missed
    best = whole.hypotheses[0].best[:1] if whole.hypotheses else np.empty((0, search.n), np.int64)
    matched = max(int((best >= 0).sum()), search.minimal + 1)
    return missed_at_random(matched, search.n, search.minimal, search.sets_done)

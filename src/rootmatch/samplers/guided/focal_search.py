"""The guided search of a camera of unknown focal length: the search of a known camera, at each of some focal lengths.

What all of them find is judged as one search: a hypothesis has to be beyond what chance reaches in all tests together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from rootmatch.deadline import Deadline
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
    if options.max_seconds is not None and options.max_seconds < deadline.left():
        deadline = Deadline(options.max_seconds)
    budget, spent = min(LIMITS.quick, options.budget // len(every)), 0
    few = replace(options, hypotheses=min(options.hypotheses, NAMED))
    while True:
        searches = []
        for one in every:
            known = replace(task, tables=one, order=task.order - 1, progress=None)
            search = Search(known, replace(few, budget=max(budget, 1)), deadline)
            with deadline.within():
                search.run()
                search.refine()
            searches.append(search)
            spent += search.evaluated
            if task.progress is not None:
                task.progress(min(spent, options.budget), options.budget)
        whole = _together(searches)
        conclusive = float(whole.hypotheses[0].evidence.max(initial=0.0)) > whole._false_alarm_level()
        budget *= LONGER
        done = all(search.evaluated < search.budget for search in searches)
        if conclusive or done or deadline.passed() or spent + len(every) * budget > options.budget:
            break
    if task.progress is not None:
        task.progress(options.budget, options.budget)
    return sampled_among(
        task, whole.clusters, few, whole.rng, spent,
        later=task.later and not task.deadline.is_set,
        deadline=task.deadline,
        conclusive=conclusive,
        assignments=whole.assignments(),
        missed=max(_missed(search, whole) for search in searches),
    )  # fmt: skip


def _together(searches: list[Search]) -> Search:
    """The first of several searches with what all of them tested and found, in one batch, the strongest first."""
    whole = searches[0]
    whole.hypotheses = [batch for search in searches for batch in search.hypotheses]
    whole.tested = sum(search.tested for search in searches)
    whole._clustered()
    return whole


def _missed(search: Search, whole: Search) -> float:
    """Probability that one of the searches has missed a pose with as many matches as the best one of all."""
    if search.conclusive or search.missed == 0.0:
        return search.missed
    matched = max(int((whole.hypotheses[0].best[:1] >= 0).sum()), search.minimal + 1)
    return missed_at_random(matched, search.n, search.minimal, search.sets_done)

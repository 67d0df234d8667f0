"""The guided search of a camera of unknown focal length: the search of a known camera, at each of some focal lengths.

What all of them find is judged as one search: a hypothesis has to be beyond what chance reaches in all tests together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any

from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.guided.candidate_hyperedges import sampled_among
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.rivals import RIVAL_MISSED, missed_rival
from rootmatch.samplers.guided.search import Search
from rootmatch.samplers.guided.visibility import missed_at_random
from rootmatch.samplers.limits import LIMITS

SEARCHED, RESERVE = 0.6, 0.3
"""Share of the time left at a deadline that all searches may take, and seconds that suffice for the hyper-edges."""
LONGER = 4
"""Factor on the budget of a search that goes on. A round value."""
NAMED = 64
"""Most assignments that are handed on to be fitted. A round value."""


def focal_tensor(task: SamplingTask, tables: Callable[[], list[Any]], options: GuidedOptions) -> SampledTensor:
    """Tensor of the hyper-edges among the correspondences that poses at all focal lengths name; see `Guided`.

    Searches go on until one has found something and no other can well have missed as good a pose.

    ``tables``: those of a camera of each focal length, whose minimal sets are one point smaller.
    """
    deadline = task.deadline.part(SEARCHED, RESERVE).at_most(options.max_seconds)
    few = replace(options, hypotheses=min(options.hypotheses, NAMED))
    tasks = [replace(task, tables=one, order=task.order - 1, progress=None) for one in tables()]
    searches, going = dict[int, Search](), list(range(len(tasks)))
    budget, spent = max(min(LIMITS.quick, options.budget // len(tasks)), 1), 0
    while going:
        for k in going:
            searches[k] = search = Search(tasks[k], replace(few, budget=budget), deadline)
            with deadline.within():
                search.run()
                search.refine()
            spent += search.evaluated
            if task.progress is not None:
                task.progress(min(spent, options.budget), options.budget)
        whole = Together(list(searches.values()))
        going = [k for k in going if whole.may_miss(searches[k])]
        budget *= LONGER
        if deadline.passed() or spent + len(going) * budget > options.budget:
            break
    if task.progress is not None:
        task.progress(options.budget, options.budget)
    return sampled_among(
        task, whole.first.clusters, few, whole.first.rng, spent,
        deadline=task.deadline,
        conclusive=whole.found,
        assignments=whole.first.assignments(),
        missed=missed_rival(whole.first, max(whole.missed(search) for search in searches.values())),
    )  # fmt: skip


class Together:
    """Several searches as one: the first of them gets copies of what all have tested and found."""

    def __init__(self, searches: list[Search]) -> None:
        self.first = first = copy(searches[0])
        first.hypotheses = [batch for search in searches for batch in search.hypotheses]
        first.tested = sum(search.tested for search in searches)
        first._clustered()
        (every,) = first.hypotheses
        self.found = float(every.evidence.max(initial=0.0)) > first._false_alarm_level()
        """Whether a hypothesis is beyond what chance reaches in all tests together."""
        self.matched = max(int((every.best[:1] >= 0).sum()), first.minimal + 1)
        """Points that the strongest hypothesis matches."""

    def missed(self, search: Search) -> float:
        """Probability that one of the searches has missed a pose with as many matches as the best one of all."""
        if search.conclusive or search.missed == 0.0:
            return search.missed
        sets = search.solved / math.perm(search.n_target, search.minimal)
        return missed_at_random(self.matched, search.n, search.minimal, sets)

    def may_miss(self, search: Search) -> bool:
        """Whether one of the searches is worth going on with: it has not ended by itself, and may have missed one."""
        ended = search.conclusive or search.missed == 0.0
        return not ended and (not self.found or self.missed(search) > RIVAL_MISSED)

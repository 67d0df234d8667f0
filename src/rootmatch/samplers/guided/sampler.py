"""The guided sampler: search, then the hyper-edges among the correspondences of its hypotheses, evaluated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

from rootmatch.backends import cpu
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.capabilities import Capability
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.exhaustive import given_tensor
from rootmatch.samplers.guided.candidate_hyperedges import hyperedges_among, random_hyperedges
from rootmatch.samplers.guided.dispatch import has_hypotheses
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.visible_search import search_of
from rootmatch.samplers.limits import LIMITS
from rootmatch.samplers.point_sets.sampler import point_set_tensor
from rootmatch.samplers.two_views.sampler import two_view_tensor

SEARCHED, RESERVE, REFINED, WEIGHED = 0.8, 0.2, 0.5, 0.5
"""Shares of the time that is left at a deadline: of the search, all but so many seconds, and then of its second sets
and of the hyper-edges of what it found."""
SECONDS_PER_EDGE = 4e-7
"""To evaluate one of those, at most (benchmarks/kernels.py)."""


def pays(task: SamplingTask) -> bool:
    """Whether a guided search is possible and cheaper than an exhaustive sweep."""
    most = LIMITS.guided if task.motions == 1 else LIMITS.guided_multi_motion
    searched = task.clouds is not None or task.views is not None
    possible = searched or has_hypotheses(type(task.tables))
    return possible and task.sweep_cost > most


def is_quick(task: SamplingTask) -> bool:
    """Whether a search by poses is quicker than a sweep that is cheap itself, and may follow if need be."""
    by_poses = task.clouds is None and task.views is None and has_hypotheses(type(task.tables))
    return task.motions == 1 and by_poses and LIMITS.swept < task.sweep_cost <= LIMITS.guided


@dataclass(frozen=True)
class Guided(GuidedOptions):
    """Guided search: a sampler for `rootmatch.match` that evaluates the hyper-edges which hypotheses support.

    Its parameters are those of `rootmatch.samplers.guided.options.GuidedOptions`; a value outside its range raises
    `InputError`. The search forms hypotheses from minimal sets and tests them on the other points.
    """

    def __call__(self, task: SamplingTask) -> SampledTensor:
        """Tensor of the hyper-edges among the correspondences that hypotheses name.

        Parameters
        ----------
        task : SamplingTask
            Its seed is that of the order in which minimal sets are tried, and of the selection of hyper-edges where
            there are too many. With one motion the search ends when one hypothesis is beyond chance, with more when as
            many are. Progress is reported between batches as (evaluations, budget).

        Raises
        ------
        InputError
            If the problem's minimal sets make no hypotheses.
        """
        tables, affinity = task.tables, task.affinity
        if task.clouds is not None:
            return point_set_tensor(task, task.clouds, self)
        if task.views is not None:
            return two_view_tensor(task, self)
        Capability.GUIDED.require(has_hypotheses(type(tables)), task.problem)
        search = search_of(task, self, task.deadline.part(SEARCHED, RESERVE))
        with search.deadline.within():
            search.run()
        if task.progress is not None:
            task.progress(self.budget, self.budget)  # most searches end long before
        with task.deadline.part(REFINED).within():
            search.refine()
        clusters = search.clusters()

        @cache
        def weighed() -> tuple[AffinityTensor, float, int]:
            """The tensor, which fraction of its hyper-edges was evaluated, and how many they are."""
            few = self
            if task.deadline.is_set:
                few = replace(self, edges=task.deadline.part(WEIGHED).affordable(self.edges, SECONDS_PER_EDGE))
            source, target, coverage = hyperedges_among(
                clusters, task.shape, task.order, few, search.rng, deadline=task.deadline
            )
            task.deadline.cuts(left_out=coverage < 1.0 and few.edges < self.edges)
            return given_tensor(task, source, target), coverage, len(source)

        # where a conclusive search knows no rivals a pose may decide alone, and nobody asks for hyper-edges
        alone = search.single and search.conclusive and len(clusters.evidence) == 1
        if task.later and alone and not task.deadline.is_set:
            tensor: AffinityTensor = DeferredTensor.of(lambda: weighed()[0], task.shape)
            coverage: Callable[[], float] | float = lambda: weighed()[1]  # noqa: E731
            evaluated = search.evaluated
        else:
            tensor, coverage, evaluated = weighed()
            evaluated += search.evaluated

        def chance() -> float:
            """Mean weight of random hyper-edges."""
            weighed()  # draws first, whoever asks first
            drawn = random_hyperedges(task.shape, task.order, self.chance_samples, search.rng)
            by_chance = cpu.residuals(tables, task.kind, *drawn)
            # no sample is large enough to say that chance never agrees
            total = max(1.0, float(affinity.weights(by_chance[by_chance <= affinity.gate]).sum()))
            return total / self.chance_samples

        return SampledTensor(
            tensor, evaluated, coverage, chance, search.conclusive,
            partial=True,
            assignments=search.assignments() if search.single else None,
            missed=search.missed,
        )  # fmt: skip

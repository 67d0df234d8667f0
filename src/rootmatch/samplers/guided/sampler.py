"""The guided sampler: search, then the hyper-edges among what it found, weighed."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.backends import cpu
from rootmatch.errors import InputError
from rootmatch.samplers.base import SampledTensor, SamplingTask
from rootmatch.samplers.exhaustive import given_tensor
from rootmatch.samplers.guided.candidate_hyperedges import hyperedges_among, random_hyperedges
from rootmatch.samplers.guided.dispatch import can_propose
from rootmatch.samplers.guided.options import GuidedOptions
from rootmatch.samplers.guided.search import Search

CHANCE_SAMPLES = 4096
"""Random hyper-edges that tell how well chance does."""
CHEAP, CHEAP_OF_MANY = 2_000_000, 200_000_000
"""Hyper-edges up to which looking at all of them takes no longer than a search for one motion, for several."""


def pays(task: SamplingTask) -> bool:
    """Whether a guided search is possible and cheaper than to look at all hyper-edges."""
    return can_propose(type(task.tables)) and task.hyperedge_count > (CHEAP if task.motions == 1 else CHEAP_OF_MANY)


@dataclass(frozen=True)
class Guided(GuidedOptions):
    """Guided search, a sampler for `rootmatch.match`; see `GuidedOptions`."""

    def __call__(self, task: SamplingTask) -> SampledTensor:
        """Tensor of the hyper-edges among the correspondences that minimal sets propose.

        Parameters
        ----------
        task : SamplingTask
            Its seed is that of the order in which minimal sets are tried, and of the choice of hyper-edges where there
            are too many. With one motion the search ends when one proposal is beyond chance, with more when as many
            are. Progress is told between batches as (evaluations, budget).

        Raises
        ------
        InputError
            If the problem has no proposals.
        """
        tables, weigh = task.tables, task.affinity
        if not can_propose(type(tables)):
            raise InputError('hyperedges: this problem has no proposals to be guided by; use "exhaustive" or "random"')
        search = Search(task, self)
        search.run()
        search.refine()
        source, target, share = hyperedges_among(search.settle(), task.shape, task.order, self, search.rng)
        tensor = given_tensor(tables, task.kind, weigh, task.shape, source, target)
        drawn = random_hyperedges(task.shape, task.order, CHANCE_SAMPLES, search.rng)
        by_chance = cpu.residuals(tables, task.kind, *drawn)
        # no sample is large enough to say that chance never agrees
        chance = max(1.0, float(weigh.weights(by_chance[by_chance <= weigh.gate]).sum())) / CHANCE_SAMPLES
        evaluated = search.evaluated + len(source) + CHANCE_SAMPLES
        return SampledTensor(tensor, evaluated, share, chance, search.found, partial=True)

"""Refinement of clusters of hypotheses: wide minimal sets of their own correspondences, to be solved anew.

Another set predicts what the first one missed, and often better.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.samplers.guided.dispatch import hypothesis_kernels
from rootmatch.samplers.guided.minimal_sets import at_every_root, widest_sets

if TYPE_CHECKING:
    from rootmatch.samplers.guided.search import Search

CLUSTERS, CLUSTER_PART = 8, 0.25
"""Clusters that are solved anew when none is beyond chance: so many or, if that is more, this fraction of them."""
SETS, SURE_SETS = 8, 4
"""Minimal sets solved anew of each cluster; and of one beyond chance, for one motion of few points without normals: it
mostly grows no more. Both find the same matches in benchmarks/record.py and benchmarks/matches.py."""


def refine_clusters(search: Search) -> None:
    """Solve minimal sets of the correspondences of a search's best clusters: of those beyond chance, or of some.

    Nothing is solved twice: not before other sets were tried and, of one motion beyond chance, not without new rivals.
    """
    if search.refined_at == search.solved:
        return
    again, search.refined_at = search.refined_at >= 0, search.solved
    leaders, _, hypotheses = search._cluster_hypotheses()
    beyond_chance = int((hypotheses.evidence[leaders] > search._false_alarm_level()).sum())
    if again and search.single and 0 < beyond_chance == search.refined_clusters:
        return
    search.refined_clusters = beyond_chance
    taken = leaders[: beyond_chance or max(CLUSTERS, int(CLUSTER_PART * len(leaders)))]
    _verify_widest(search, hypotheses.best[taken], search.sure_sets if beyond_chance else SETS, search.rng)


def verify_known(search: Search, assignments: Integers) -> None:
    """Verify wide minimal sets of assignments (K, n) that are known before a search, of each its own."""
    rng = np.random.default_rng(search.n)  # the search draws the same sets whatever is known
    _verify_widest(search, assignments, SETS, rng)


def _verify_widest(search: Search, assignments: Integers, count: int, rng: np.random.Generator) -> None:
    """Verify up to ``count`` wide minimal sets of the matches of each of some assignments (K, n)."""
    sets, images = [np.empty((0, search.minimal), np.int64)], [np.empty((0, search.minimal), np.int64)]
    for assignment in assignments:
        (matched,) = (assignment >= 0).nonzero()
        sets.append(widest_sets(search.positions, matched, search.minimal, count, rng))
        images.append(assignment[sets[-1]])
    solutions = hypothesis_kernels(search.tables).solutions
    search._verify(*at_every_root(np.concatenate(sets), np.concatenate(images), solutions))

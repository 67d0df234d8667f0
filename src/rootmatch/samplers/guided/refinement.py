"""Refinement of clusters of hypotheses: wide minimal sets of their own correspondences, to be solved anew.

Another set predicts what the first one missed, and often better.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.samplers.guided.dispatch import hypothesis_kernels
from rootmatch.samplers.guided.hypotheses import Hypotheses
from rootmatch.samplers.guided.minimal_sets import widest_sets

if TYPE_CHECKING:
    from rootmatch.samplers.guided.search import Search

CLUSTERS, CLUSTER_PART = 8, 0.25
"""Clusters that are solved anew when none is beyond chance: so many or, if that is more, this fraction of them."""
SETS, SURE_SETS = 8, 4
"""Minimal sets solved anew of each cluster; and of one beyond chance, for one motion of few points without normals: it
mostly grows no more. Both find the same matches in benchmarks/record.py and benchmarks/matches.py."""


def refining_sets(
    hypotheses: Hypotheses,
    leaders: Integers,
    beyond_chance: int,
    positions: Floats,
    solutions: int,
    count: int,
    rng: np.random.Generator,
) -> tuple[Integers, Integers]:
    """Minimal sets (K, m) of the best clusters, with roots and images (K, 1 + m), each set once for every root.

    Parameters
    ----------
    hypotheses : Hypotheses
    leaders : (G,) int64 array
        The strongest of each cluster, strongest first.
    beyond_chance : int
        How many clusters are: they are taken, or some if none is.
    positions : (n, 3) array
    solutions : int
        Most solutions of a minimal set.
    count : int
        Minimal sets of each cluster.
    rng : Generator
    """
    taken = leaders[: beyond_chance or max(CLUSTERS, int(CLUSTER_PART * len(leaders)))]
    minimal, most = hypotheses.points.shape[1], (solutions, count)
    return _widest_sets_of_matches(hypotheses.best[taken], minimal, positions, most, rng)


def verify_known(search: Search, assignments: Integers) -> None:
    """Verify wide minimal sets of assignments (K, n) that are known before a search, of each its own."""
    solutions = hypothesis_kernels(search.tables).solutions
    rng = np.random.default_rng(search.n)  # the search draws the same sets whatever is known
    points, images = _widest_sets_of_matches(assignments, search.minimal, search.positions, (solutions, SETS), rng)
    if len(points):
        search._verify(points, images)


def _widest_sets_of_matches(
    assignments: Integers, minimal: int, positions: Floats, most: tuple[int, int], rng: np.random.Generator
) -> tuple[Integers, Integers]:
    """See `refining_sets`, of the matches of some assignments (K, n); ``most``: its ``solutions`` and ``count``."""
    solutions, count = most
    points, images = [np.empty((0, minimal), np.int64)], [np.empty((0, minimal), np.int64)]
    for assignment in assignments:
        (matched,) = (assignment >= 0).nonzero()
        chosen = widest_sets(positions, matched, minimal, count, rng)
        points.append(np.repeat(chosen, solutions, axis=0))
        images.append(np.repeat(assignment[chosen], solutions, axis=0))
    stacked = np.concatenate(points)
    solved = np.empty((len(stacked), 1 + minimal), np.int64)
    solved[:, 0] = np.arange(len(stacked)) % solutions
    solved[:, 1:] = np.concatenate(images)
    return stacked, solved

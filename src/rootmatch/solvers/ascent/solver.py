"""Multi-start discrete ascent: the default solver."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.deadline import NEVER, Deadline
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.ascent.multi_start import MultiStart
from rootmatch.solvers.ascent.options import AscentOptions
from rootmatch.solvers.ascent.subset_index import SubsetIndex, build_index
from rootmatch.solvers.base import Solution, empty_solution, is_empty


@dataclass(frozen=True)
class MultiStartAscent(AscentOptions):
    """Ascent of the discrete score from the best supported hyper-edges.

    The objective of an assignment X is the sum of the weights of the hyper-edges inside it and of its unary weights,
    less ``penalty · C(|X|, d)``. The true assignment is its optimum long after power iteration has ceased to find it.

    1. A few steps of a reweighted random walk, which uses all hyper-edges at once, and the best move from there (see
       `climb`) until none is left: the better start where every hyper-edge is a little right. Where it holds two
       thirds of all weight, no other assignment can score much more, and step 5 follows at once.
    2. Support of each hyper-edge: the weights of those that share d−1 correspondences with it. Candidates are the best
       supported hyper-edges of all, and the best one of each correspondence. Each grows, by an ascent with a penalty
       that only a dense group survives, into a core; candidates that share d−1 correspondences with an earlier core are
       skipped. Few at first, then twice as many each time.
    3. An ascent from each core as soon as it is grown, until the best assignment is settled: `agreement`
       ascents have reached it, its score stands far out, or nothing better has come for long. Then ascents from a few
       candidates outside of everything found.
    4. An ascent from as many of the cores as go together, the best first, and from the best assignment with one core
       forced into it, where that may pay: several independent groups of points, as moving objects give, are found.
    5. From the best few optima on with exchanges of two points.

    A point in no hyper-edge stays unmatched. Strictly monotone, without randomness, and the same for any number of
    threads; runs on `numba.get_num_threads()` threads.

    Memory beside the tensor: 8 bytes a hyper-edge for support, and 6 d to 8 d for the index (see `subset_index`); 32 to
    40 at order 4. At order 3 up to 120 where a table of pairs is worth it (see `pair_table`), up to 2.8 million.

    Its options are those of `AscentOptions`.
    """

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0, deadline: Deadline = NEVER) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor):
            return empty_solution(tensor)
        return self.solve(build_index(tensor), deadline)

    def solve(self, index: SubsetIndex, deadline: Deadline = NEVER) -> Solution:
        """Solve with an index that was built before."""
        search = MultiStart(self, index, deadline)
        with deadline.within():
            search.start_from_walk()
        with deadline.within():
            if not search.dominates():
                search.start_from_cores()
                search.start_from_rivals()
                search.start_from_packed_cores()
                search.polish()
                search.start_from_best()
            search.polish()
        return search.solution()

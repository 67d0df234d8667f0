"""Multi-start discrete ascent: the default solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.ascent.multi_start import Search
from rootmatch.solvers.ascent.subset_index import SubsetIndex, build_index
from rootmatch.solvers.base import Solution, is_empty, nothing


@dataclass(frozen=True)
class MultiStartAscent:
    """Ascent of the discrete score from the best supported hyper-edges.

    The objective of an assignment X is the sum of the weights of the hyper-edges inside it and of its unary weights,
    less ``penalty · C(|X|, d)``. The true assignment is its optimum long after power iteration has ceased to find it.

    1. A few steps of a reweighted random walk, which sees all hyper-edges at once, and the best move from there (see
       `local_search`) until none is left: the better start where every hyper-edge is a little right.
    2. Support of each hyper-edge: the weights of those that share d−1 correspondences with it. Candidates are the best
       supported hyper-edges of all, and the best one of each correspondence. Each grows, by an ascent with a penalty
       that only a dense group survives, into a core; candidates that share d−1 correspondences with a core found
       before are passed over. Few at first, then twice as many each time.
    3. An ascent from each core as soon as it is grown, until `agreement` of them have come to the same best assignment,
       it stands far out among the others, or nothing better has come for long; and from a few candidates outside of
       what was found. Where the score tells the truth it is reached from one of the first cores. Where it does not,
       later ones are as likely as any to lead a little higher, to no use.
    4. An ascent from as many of the cores as go together, the best first, and from the best assignment with one core
       put in by force, where that may pay: several independent groups of points, as moving objects give, are found.
    5. From the best few optima on with exchanges of two points.

    A point to which no hyper-edge speaks stays unmatched. Strictly monotone, without chance, and the same for any
    number of threads; runs on `numba.get_num_threads()` threads.

    Memory beside the tensor: 8 bytes a hyper-edge for support, and 6 d to 8 d for the index (see `subset_index`); 32 to
    40 at order 4. At order 3 up to 120 where a table of pairs is worth it (see `pair_table`), up to 2.8 million.

    Parameters
    ----------
    starts : int
        Cores, ascents from them, and cores put into the best assignment, at most of each.
    walk : int
        Steps of the random walk (`random_walk_start`) at most; 0 for none.
    agreement : int
        Ascents to the best assignment, from different cores, that are enough.
    penalty : float
        Weight that the hyper-edges of a matched point must exceed on average for it to stay matched: the points without
        image are then left out. 0: the plain score of the paper. Meaningful when all hyper-edges are in the tensor.
    keep : int
        Alternatives to report: other optima and single changes of the answer.
    limit : int
        Moves of one ascent.
    """

    starts: int = 200
    walk: int = 10
    agreement: int = 12
    penalty: float = 0.0
    keep: int = 16
    limit: int = 10_000

    def __post_init__(self) -> None:
        if min(self.starts, self.agreement, self.limit) < 1 or min(self.walk, self.keep) < 0:
            raise InputError("MultiStartAscent: expected starts, agreement, limit ≥ 1 and walk, keep ≥ 0")
        if not 0 <= self.penalty < np.inf:
            raise InputError(f"penalty: got {self.penalty}; expected a finite weight ≥ 0")

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """Solve; nothing here is random, the seed is not used."""
        if is_empty(tensor):
            return nothing(tensor)
        return self.solve(build_index(tensor))

    def solve(self, index: SubsetIndex) -> Solution:
        """Solve with an index that was built before."""
        search = Search(self, index)
        search.from_walk()
        search.from_cores()
        search.from_rivals()
        search.from_packed_cores()
        search.polish()
        search.from_best()
        search.polish()
        return search.solution()

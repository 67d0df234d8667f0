"""Options of the multi-start ascent."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option


@dataclass(frozen=True)
class AscentOptions(Options):
    """How hard the ascent searches.

    Parameters
    ----------
    starts : int
        Cores, ascents from them, and cores forced into the best assignment, at most of each. With a sixteenth of them
        the same optimum is found on the published protocols (docs/hypergraph.md).
    walk : int
        Steps of the random walk (`random_walk_start`) at most; 0 for none.
    agreement : int
        Ascents to the best assignment, from different cores, that are enough. benchmarks/solvers.py compares it with
        a number that is never reached, so that all starts are made.
    penalty : float
        Weight that the hyper-edges of a matched point must exceed on average for it to stay matched: the points without
        image are then left out. 0: the plain score of the paper. Meaningful when all hyper-edges are in the tensor.
    keep : int
        Alternatives to report: other optima and single changes of the best assignment.
    limit : int
        Moves of one ascent, at most: a safeguard, far above what any takes.
    max_reads : int
        Entries of the index that ascents may read. No other begins that would go beyond, by those made so far; but the
        first one, and that with exchanges from the best assignment. The bound of what a tensor of 10⁸ hyper-edges takes
        (benchmarks/large_tensors.py); it is not met by smaller ones, and unlike a time it is the same on every machine.
    rivals : int
        Candidates outside of all that was found from which an ascent is made in any case.
    """

    starts: int = option(200, minimum=1)
    walk: int = option(10, minimum=0)
    agreement: int = option(12, minimum=1)
    penalty: float = option(0.0, minimum=0.0)
    keep: int = option(16, minimum=0)
    limit: int = option(10_000, minimum=1)
    max_reads: int = option(30_000_000, minimum=0)
    rivals: int = option(16, minimum=0)

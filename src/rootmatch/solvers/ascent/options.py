"""Options of the multi-start ascent."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option
from rootmatch.solvers.ascent.random_walk_start import WalkOptions
from rootmatch.solvers.ascent.stopping import AscentStoppingOptions
from rootmatch.solvers.base import DOMINANT

__all__ = ["AscentOptions", "AscentStoppingOptions", "WalkOptions"]


@dataclass(frozen=True)
class AscentOptions(Options):
    """How hard the ascent searches.

    Parameters
    ----------
    starts : int
        Cores, ascents from them, and cores forced into the best assignment, at most of each. With a sixteenth of them
        the same optimum is found on the published protocols (docs/hypergraph.md).
    walk : int
        Steps of the random walk (`random_walk_start`) at most; 0 for none. A round value, not tuned.
    agreement : int
        Ascents to the best assignment, from different cores, that are enough. benchmarks/solvers.py compares it with
        an agreement that never comes.
    penalty : float
        Weight that the hyper-edges of a matched point must exceed on average for it to stay matched: the points without
        image are then left out. 0: the plain score of the paper. Meaningful when all hyper-edges are in the tensor.
    keep : int
        Alternatives to report: other optima and single changes of the best assignment.
    limit : int
        Moves of one ascent. A bound that is never met, not tuned.
    most_reads : int
        Entries of the index that ascents may read. No other begins that would go beyond, by those made so far; but the
        first one, and that with exchanges from the best assignment. The bound of what a tensor of 10⁸ hyper-edges takes
        (benchmarks/large_tensors.py); it is not met by smaller ones, and unlike a time it is the same on every machine.
    ranking_reads : int
        Entries of the index that are read to rank hyper-edges by their support. Of a tensor with more subsets the
        heaviest hyper-edges are ranked alone, as many as that allows.
    pool : int
        Best supported hyper-edges that are candidates, for each start. A round value, not tuned.
    starts_per_correspondence : int
        Starts of small problems, which have no more that differ. A round value, not tuned.
    first_round, largest_round : int
        Candidates tried together at first, twice as many each time, and at most: the first few often find the optimum,
        and those inside it are then not tried. Round values, not tuned.
    usual_weight : float
        Usual weight of a hyper-edge over the largest, for the score that a candidate may lead to. Half; not tuned.
    core_density : float
        Weight over the largest that the hyper-edges of a core must have on average, those missing counted as 0. A round
        value, not tuned.
    dominant : float
        Share of the weight of all hyper-edges from which the assignment that the walk leads to is not searched beyond;
        see `rootmatch.solvers.base.DOMINANT`.
    hopeless : float
        Score over the best below which a candidate is not tried. A round value, not tuned.
    rivals : int
        Candidates outside of all that was found from which an ascent is made in any case. A round value, not tuned.
    forced_gain : float
        Score of a core over the gains that it displaces from which it is forced into the best assignment: an ascent may
        win the rest. A round value, not tuned.
    polished : int
        Optima that go on with exchanges of two points, at a time. benchmarks/solvers.py: for all of them it would cost
        most of the time.
    polished_score : float
        Score over the best from which they do. Set with `polished`.
    claimed : float
        Gain over the median gain from which a point is claimed by an assignment: alternatives that move a claimed
        point come first. As `rootmatch.hypergraph.assignment.drop_unsupported`.
    doubtful_part : float
        Fraction of the alternatives left to those that move only doubtful points. A round value, not tuned.
    neighbours_per_kept : int
        Single changes that are scored for each alternative to report. A round value, not tuned.
    lookups_per_thread : int
        Looked-up subsets that are worth a thread, half a millisecond to some. Changes no result.
    walk_start : WalkOptions
    stopping : AscentStoppingOptions
    """

    starts: int = option(200, least=1)
    walk: int = option(10, least=0)
    agreement: int = option(12, least=1)
    penalty: float = option(0.0, least=0.0)
    keep: int = option(16, least=0)
    limit: int = option(10_000, least=1)
    most_reads: int = option(30_000_000, least=0)
    ranking_reads: int = option(1 << 23, least=1)
    pool: int = option(4, least=1)
    starts_per_correspondence: int = option(2, least=1)
    first_round: int = option(2, least=1)
    largest_round: int = option(64, least=1)
    usual_weight: float = option(0.5, above=0.0)
    core_density: float = option(0.2, least=0.0)
    dominant: float = option(DOMINANT, least=0.5)
    hopeless: float = option(1e-3, least=0.0)
    rivals: int = option(16, least=0)
    forced_gain: float = option(0.5, least=0.0)
    polished: int = option(12, least=1)
    polished_score: float = option(0.7, above=0.0, most=1.0)
    claimed: float = option(0.2, least=0.0)
    doubtful_part: float = option(0.25, least=0.0, most=1.0)
    neighbours_per_kept: int = option(4, least=1)
    lookups_per_thread: int = option(20_000, least=1)
    walk_start: WalkOptions = option(WalkOptions())
    stopping: AscentStoppingOptions = option(AscentStoppingOptions())

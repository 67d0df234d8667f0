"""The rule for stopping the multi-start ascent: the best assignment is settled, or further starts are in vain."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option


@dataclass(frozen=True)
class AscentStoppingOptions(Options):
    """When no further cores are grown.

    Set on 226 tensors and 200 instances of each cell of the published protocols, seeds from 1000 on; see
    docs/notebook/performance.md and docs/hypergraph.md.
    """

    lead: float = option(1.5, above=1.0)
    """Score of the best assignment over that of any other from which it stands out. A round value; the work that it
    saves is in benchmarks/solvers.py."""
    lead_after: int = option(24, least=0)
    """Ascents without which the lead says nothing. A round value; benchmarks/solvers.py."""
    patience: int = option(24, least=1)
    """Candidates in a row that bring nothing better after which no more are tried, at least: 87 ascents then do what
    255 did (docs/notebook/performance.md)."""
    correspondences_per_candidate: int = option(16, least=1)
    """Correspondences for which one more candidate is tried in large problems. Set with `patience`."""
    reads: int = option(110_000, least=0)
    """Entries of the index that candidates may read if ascents are cheap. Set with `patience`."""
    patience_after_walk: int = option(14, least=1)
    """Patience where nothing better than the ascent from the random walk has come yet: 52 ascents then do what 83 did,
    and after 6 two of 226 tensors end lower (docs/notebook/performance.md)."""


def patience(options: AscentStoppingOptions, correspondences: int, reads_per_ascent: float) -> int:
    """Candidates in a row from which nothing better comes, after which a problem of some size is given up.

    Where the score tells the truth, its optimum is reached from one of the first candidates. Where it does not, later
    ones are as likely as any to lead a little higher, to no use.
    """
    by_reads = int(options.reads / max(reads_per_ascent, 1.0))
    return max(options.patience, correspondences // options.correspondences_per_candidate, by_reads)


def stands_out(options: AscentStoppingOptions, values: list[float], ascents: int) -> bool:
    """Whether the best objective of these ascents is far above every other."""
    ranked = sorted(values, reverse=True)
    return ascents > options.lead_after and (len(ranked) < 2 or ranked[0] > options.lead * ranked[1])

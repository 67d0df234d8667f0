"""The rule for stopping the multi-start ascent: the best assignment is settled, or further starts are in vain.

Its numbers were set on 226 tensors and 200 instances of each cell of the published protocols, seeds from 1000 on; see
docs/notebook/performance.md and docs/hypergraph.md.
"""

from __future__ import annotations

LEAD = 1.5
"""Score of the best assignment over that of any other from which it stands out. The work that it saves is in
benchmarks/solvers.py."""
LEAD_AFTER = 24
"""Ascents without which the lead says nothing. benchmarks/solvers.py."""
PATIENCE = 24
"""Candidates in a row that bring nothing better after which no more are tried, at least: 87 ascents then do what 255
did (docs/notebook/performance.md)."""
CORRESPONDENCES_PER_CANDIDATE = 16
"""Correspondences for which one more candidate is tried in large problems. Set with `PATIENCE`."""
READS = 110_000
"""Entries of the index that candidates may read if ascents are cheap. Set with `PATIENCE`."""
PATIENCE_AFTER_WALK = 14
"""Patience where nothing better than the ascent from the random walk has come yet: 52 ascents then do what 83 did, and
after 6 two of 226 tensors end lower (docs/notebook/performance.md)."""


def patience(correspondences: int, reads_per_ascent: float) -> int:
    """Candidates in a row from which nothing better comes, after which a problem of some size is given up.

    Where the score tells the truth, its optimum is reached from one of the first candidates. Where it does not, later
    ones are as likely as any to lead a little higher, to no use.
    """
    by_reads = int(READS / max(reads_per_ascent, 1.0))
    return max(PATIENCE, correspondences // CORRESPONDENCES_PER_CANDIDATE, by_reads)


def stands_out(values: list[float], ascents: int) -> bool:
    """Whether the best objective of these ascents is far above every other."""
    ranked = sorted(values, reverse=True)
    return ascents > LEAD_AFTER and (len(ranked) < 2 or ranked[0] > LEAD * ranked[1])

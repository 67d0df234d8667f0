"""How the work of a search is divided into batches, and how much of each is verified.

Its cost is measured in benchmarks/guided.py and benchmarks/matches.py.
"""

from __future__ import annotations

FIRST, LARGEST = 8_000, 400_000
"""Minimal sets solved before the first look at what was found; each batch is twice the one before, up to the
largest."""
START = 2_000
"""Minimal sets solved before the first look, for one motion without normals."""
GROWTH = 0.25
"""Minimal sets of its next batch over all before, if that is more than the last: the right set comes at a random time,
and a batch is finished first. A tenth to a half fewer evaluations than batches of 8,000 and twice the one before
(benchmarks/matches.py, 20 seeds)."""
CHUNKS = 8
"""Parts of a batch, whatever the number of threads, so that the result does not depend on it."""
WORTH_A_THREAD = 4_000
"""Minimal sets that are worth waking a thread for, about half a millisecond. Changes no result."""
REMEMBERED = 4_000
"""Hypotheses that are kept from batch to batch."""
APART = 16
"""Batches whose hypotheses are kept apart until they are joined and the weakest forgotten."""

MIN_KEPT, SURPLUS = 8, 2.0
"""Survivors of the sequential test that a chunk keeps at the least, and so many times its equal share of those that are
verified: some chunks have more of the best."""
MIN_VERIFIED, MIN_VERIFIED_OF_MANY = 32, 1_024
"""Survivors of a batch that are verified, at least, for one motion and for several, whose few points hardly stand out
before."""
SETS_PER_VERIFIED, SETS_PER_VERIFIED_OF_MANY = 500, 20
"""Minimal sets solved for each further one, for one motion and for several."""
SETS_PER_VERIFIED_OF_SHAPE = 2_000
"""Minimal sets, those not solved for their shape among them, for each further one where triples are listed."""


def next_batch(batch: int, solved: int | None = None) -> int:
    """Minimal sets of the batch that follows one of ``batch``: twice as many, or by how many were solved so far."""
    return min(2 * batch if solved is None else max(batch, int(GROWTH * solved)), LARGEST)


def verification_count(solved: int, single: bool) -> int:
    """Survivors to verify of a batch of ``solved`` minimal sets."""
    if not single:
        return max(MIN_VERIFIED_OF_MANY, solved // SETS_PER_VERIFIED_OF_MANY)
    # of a batch smaller than the first one of other searches, as many in proportion
    minimum = min(MIN_VERIFIED, solved * MIN_VERIFIED // FIRST + 1)
    return max(minimum, solved // SETS_PER_VERIFIED)


def listed_verification_count(tried: int) -> int:
    """Survivors to verify of so many image triples that were listed."""
    return max(MIN_VERIFIED, tried // SETS_PER_VERIFIED_OF_SHAPE)


def survivors_per_chunk(verified: int) -> int:
    """Survivors that a chunk keeps of a batch of which so many are verified."""
    return max(MIN_KEPT, int(verified * SURPLUS / CHUNKS))

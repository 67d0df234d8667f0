"""Whether the hyper-edges of an assignment agree: its score by them alone, and the points that they support."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import Deadline, Pace
from rootmatch.explain.decide import TRUST
from rootmatch.hypergraph.support import drop_unsupported, scores_of
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers.base import Alternatives

SUPPORTED = 0.5
"""Share of the time left at a deadline for the support of the alternatives; the rest is for fits of poses."""


def agreement(tensor: AffinityTensor, assignments: Sequence[Integers]) -> list[float]:
    """Scores of assignments by hyper-edges alone, because prior weights do not say whether the points agree."""
    alone = AffinityTensor.unchecked(tensor.indices, tensor.weights, tensor.shape)
    return [float(value) for value in scores_of(alone, np.array(assignments))]


def supported(
    assignment: Integers, alternatives: Alternatives, tensor: AffinityTensor, deadline: Deadline
) -> tuple[Integers, float, Alternatives]:
    """Assignments without unsupported points, distinct, best first; as many as the deadline allows."""
    candidates = np.array([assignment, *(other for other, _ in alternatives)])
    pace = Pace(deadline.part(SUPPORTED))
    # the first one in any case
    parts = [_supported(candidates[:1], tensor)] if deadline.is_set else []
    done = len(parts)
    while done < len(candidates) and (few := pace.block(len(candidates) - done)):
        parts.append(_supported(candidates[done : done + few], tensor))
        done += few
    kept = np.concatenate([part[0] for part in parts])
    scores = np.concatenate([part[1] for part in parts])
    distinct = {one.tobytes(): (one, float(value)) for one, value in zip(kept, scores, strict=True)}
    ranked = sorted(distinct.values(), key=lambda pair: -pair[1])
    (best, score), rest = ranked[0], ranked[1:]
    # an assignment that merely leaves some of the points out is not a different one
    different = [pair for pair in rest if np.any((pair[0] >= 0) & (pair[0] != best))]
    return best, score, different


def _supported(candidates: Integers, tensor: AffinityTensor) -> tuple[Integers, Floats]:
    """Assignments (K, n) without unsupported points, and their scores (K,)."""
    kept, scores = drop_unsupported(tensor, candidates, TRUST.support)
    matched = (kept >= 0).sum(axis=1)
    last = (tensor.shape[0] - matched) * (tensor.shape[1] - matched) <= TRUST.last_pairs
    if last.any():
        more, more_scores = drop_unsupported(tensor, candidates, TRUST.last_support)
        kept[last], scores[last] = more[last], more_scores[last]
    return kept, scores

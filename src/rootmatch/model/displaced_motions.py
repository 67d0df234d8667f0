"""Labellings of an object that repeats itself, displaced along itself.

A search ends with what explains most. Of an object that repeats itself that is where its image overlaps it most, and
the right labelling may be more periods away than any that it found. So the motions between rivals displace each of
them, again and again: what else there is to choose from.
"""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.repetition import RIVALS, select_rival_motions
from rootmatch.problems.pose_fit.point_set_fit import FEWEST
from rootmatch.samplers.point_sets.congruent import grow_labellings, label_by_motions
from rootmatch.samplers.point_sets.motions import Motions

DISPLACED = 64
"""Most displaced labellings that are displaced again. A round value; it bounds time."""
ROUNDS = 4
"""Rounds in which labellings are displaced by the motions between them, as long as that finds more. A round value."""


def add_displaced(model: PointSetModel, proposals: Judged) -> Judged:
    """Labellings with those that the motions between rivals make of them, as long as these are better than clutter."""
    rivals = select_rival_motions(proposals, most=DISPLACED)
    if len(rivals) < 2:
        return proposals
    first, last = _homogeneous_matrices(proposals.take(rivals[:1])), proposals.take(rivals)
    known = set(map(bytes, proposals.fit.assignments))
    for _ in range(ROUNDS):
        checkpoint()
        at = _homogeneous_matrices(last)
        # those with the fewest matches in common reach twice as far in each round
        away = at[np.unique([*range(min(len(at), RIVALS)), *range(max(len(at) - RIVALS, 0), len(at))])]
        away = away @ np.linalg.inv(first)
        away = np.concatenate([away, np.linalg.inv(away)])
        more = _label_about(model, (away[:, None] @ at).reshape(-1, *first.shape[1:]))
        more = more[[bytes(one) not in known for one in more]]
        known.update(map(bytes, more))
        judged = model.judged(more)
        last = judged.take(select_rival_motions(judged, most=DISPLACED))
        if not len(last.log_odds):
            break
        proposals = proposals.joined(last)
    return proposals


def _homogeneous_matrices(judged: Judged) -> Floats:
    """The motions of labellings as matrices (K, k + 1, k + 1)."""
    fit, size = judged.fit, judged.fit.rotation.shape[1]
    whole = np.zeros((len(fit.scale), size + 1, size + 1))
    whole[:, :size, :size] = fit.scale[:, None, None] * fit.rotation
    whole[:, :size, size], whole[:, size, size] = fit.shift, 1.0
    return whole


def _label_about(model: PointSetModel, motions: Floats) -> Integers:
    """Labellings (H, n) about motions, given as matrices."""
    linear = motions[:, :-1, :-1]
    scale = np.abs(np.linalg.det(linear)) ** (1.0 / linear.shape[1])
    found = label_by_motions(model.clouds, [Motions(linear, motions[:, :-1, -1], scale)], model.allowed, FEWEST)
    return grow_labellings(model.clouds, found, model.mirror, model.allowed)

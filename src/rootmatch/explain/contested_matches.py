"""Points and detections that several motions claim: each goes to the motion for which it speaks most.

A motion that was found first takes what fits it by accident, and its own motion is then judged without it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.hypergraph.assignment import maximise_total
from rootmatch.model.evidence import settle_poses
from rootmatch.model.matchings import Matchings, sum_matchings_by_part
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.pose_density import MINIMUM
from rootmatch.model.prediction import GATE
from rootmatch.model.proposals import fit_assignments
from rootmatch.problems.pose_fit.point_set_fit import FEWEST

SMALL = 16
"""Matches of a motion, at most, of which one may draw the pose so far that what has more claim to its point or
detection is no longer near. A round value."""


class Claims(NamedTuple):
    """What a motion matches, and each pair that it could match in the place of these, or beside them."""

    points: Integers
    detections: Integers
    gains: Floats
    """(m,) all three. The gains are log-odds of each pair, given the motion's own matches of other points and
    detections."""
    own: int
    """Number of its own matches."""


class SharedOut(NamedTuple):
    """What each motion has, where several claim the same."""

    assignment: Integers
    labels: Integers
    """(n,) both, −1 where nothing is claimed."""
    certainty: Floats
    """(n,) what remains of the probability of a match, or of none, as other motions may have the point or detection."""
    unclaimed: Floats
    """(n,) probability that no motion has the point."""
    together: float
    """What remains of that of all matches."""


def image_claims(body: Candidate, own: Integers) -> Claims:
    """The claims of a motion among all detections, by its own matches (n,)."""
    model = body.model
    _, found, at = fit_assignments(model, own[None])
    if not len(found.log_odds):
        return _without_rivals(own)
    fewer = _with_each_left_out(own)
    first = np.zeros(len(fewer), np.int64)
    found, at = settle_poses(model, fewer, at.rotation[first], at.position[first])
    poses = zip(range(len(fewer)), found.covariance, strict=True)
    squared = [at.one(k).squared_distances_from(model.target, model.sigma, spread) for k, spread in poses]

    def log_odds(rows: Integers, leads: Integers) -> Floats:
        return settle_poses(model, rows, at.rotation[leads], at.position[leads])[0].log_odds

    return _claims(own, np.where(at.seen[..., None], squared, np.inf), model.allowed, log_odds)


def space_claims(model: PointSetModel, own: Integers) -> Claims:
    """The claims of a motion among all targets, by its own matches (n,)."""
    if (own >= 0).sum() <= FEWEST:
        return _without_rivals(own)
    squared, variance = model.fit(_with_each_left_out(own)).squares()
    return _claims(own, squared / variance, model.allowed, lambda rows, _: model.judge(rows).log_odds)


def _without_rivals(own: Integers) -> Claims:
    """The claims of a motion to its own matches (n,) alone, that are worth nothing."""
    points = np.flatnonzero(own >= 0)
    return Claims(points, own[points], np.zeros(len(points)), len(points))


def _with_each_left_out(own: Integers) -> Integers:
    """Matches (n,) of a motion, and of a small one these without each of them."""
    matched = np.flatnonzero(own >= 0)
    if not MINIMUM < len(matched) <= SMALL:
        return own[None]
    every = np.tile(own, (1 + len(matched), 1))
    every[1 + np.arange(len(matched)), matched] = -1
    return every


def _claims(
    own: Integers, squared: Floats, allowed: Bools | None, log_odds: Callable[[Integers, Integers], Floats]
) -> Claims:
    """Claims to the own matches and to pairs near the motion, by what each adds to the own matches that it leaves.

    So where two motions exchange a point or a detection, each is weighed without what it gives.

    ``squared``: (K, n, n') squared distances from where points are predicted by `_with_each_left_out`, over their
    variances. ``log_odds``: of assignments (L, n), each led to by one of those, (L,).
    """
    count, matched = squared.shape[2], np.flatnonzero(own >= 0)
    of_point, of_detection = np.zeros(len(own), np.int64), np.zeros(count, np.int64)
    of_point[matched] = of_detection[own[matched]] = 1 + np.arange(len(matched))
    without = np.maximum(of_point[:, None], of_detection)
    leads = without if len(squared) > 1 else np.zeros_like(without)
    near = squared[leads, np.arange(len(own))[:, None], np.arange(count)] < GATE**2
    near &= (of_point[:, None] == 0) | (of_detection == 0)  # its own model tells which of its points has which
    near = near if allowed is None else near & allowed
    near[matched, own[matched]] = True
    i, j = np.nonzero(near)
    left = np.tile(own, (1 + len(matched), 1))
    left[1 + np.arange(len(matched)), matched] = -1
    rows, lead = left[without[i, j]], leads[i, j]
    rows[np.arange(len(i)), i] = j
    worth = log_odds(np.concatenate([left, rows]), np.concatenate([np.arange(len(left)) % len(squared), lead]))
    return Claims(i, j, worth[len(left) :] - worth[without[i, j]], len(matched))


def allot_claims(claims: dict[int, Claims], n: int, n_target: int) -> SharedOut:
    """Each of n points and n' detections given to the motions so that their claims have the largest total, by label.

    The model of one motion takes what is of the others for points missed and for clutter; so each claim is worth more
    by what it costs to leave a point and a detection where all motions together leave few. How sure the shares are is
    the sum over all ways to share out, each with the product of the odds of its claims, in the place of those in which
    each motion has what is its own or nobody's: what is doubtful among these, its own model tells.
    """
    i, j, gain = (np.concatenate(each) for each in list(zip(*claims.values(), strict=True))[:3])
    label = np.repeat([*claims], [len(one.points) for one in claims.values()])
    total = min(sum(one.own for one in claims.values()), n, n_target)
    for which, one in claims.items():
        missed = (total + 1.0) / (n - total + 1.0) * (n - one.own + 1.0) / (one.own + 1.0)
        gain[label == which] += math.log(missed * (n_target - one.own + 0.5) / (n_target - total + 0.5))
    i, j, gain, label = i[gain > 0.0], j[gain > 0.0], gain[gain > 0.0], label[gain > 0.0]
    order = np.argsort(gain, kind="stable")
    worth, whose = np.zeros((n, n_target)), np.full((n, n_target), -1)
    worth[i[order], j[order]], whose[i[order], j[order]] = gain[order], label[order]
    assignment = maximise_total(worth, 0.0)
    matched, labels, holder = np.flatnonzero(assignment >= 0), np.full(n, -1), np.full(n_target, -1)
    labels[matched] = holder[assignment[matched]] = whose[matched, assignment[matched]]
    apart = ((labels[i] == label) | (labels[i] < 0)) & ((holder[j] == label) | (holder[j] < 0))
    every, kept = (sum_matchings_by_part(gain[None, some], i[some], j[some], 0.0) for some in (gain > 0.0, apart))
    (held, unclaimed), (apart_held, _) = (_chances(one, assignment, worth) for one in (every, kept))
    certainty = np.minimum(held / np.maximum(apart_held, 1e-300), 1.0)
    together = math.exp(min(float(kept.log_total[0] - every.log_total[0]), 0.0))
    return SharedOut(assignment, labels, certainty, unclaimed, together)


def _chances(told: Matchings, assignment: Integers, worth: Floats) -> tuple[Floats, Floats]:
    """Probability (n,) that a point has what it is assigned, by a claim of that worth, and that no motion has it."""
    chance, n = told.marginals[0], len(assignment)
    own = (assignment[told.rows] == told.columns) & (worth[told.rows, told.columns] == told.log_odds[0])
    unclaimed = np.maximum(1.0 - np.bincount(told.rows, chance, n), 0.0)
    held = unclaimed.copy()
    held[told.rows[own]] = chance[own]
    return held, unclaimed

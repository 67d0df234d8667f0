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
from rootmatch.model.evidence import weigh_poses
from rootmatch.model.matchings import sum_matchings_by_part
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.prediction import GATE
from rootmatch.model.proposals import fit_assignments
from rootmatch.problems.pose_fit.point_set_fit import FEWEST


class Claims(NamedTuple):
    """What a motion matches, and each point that it could match beside that."""

    assignment: Integers
    """(n,)"""
    gains: Floats
    """(n,) log-odds of each match, given all that are its own; 0 where there is none."""
    own: int
    """Number of its own matches."""

    def rows(self, label: int) -> Floats:
        """Point, detection, gain and label (m, 4) of each claim."""
        i = np.flatnonzero(self.assignment >= 0)
        return np.column_stack([i, self.assignment[i], self.gains[i], np.full(len(i), label)])


class SharedOut(NamedTuple):
    """What each motion has, where several claim the same."""

    assignment: Integers
    labels: Integers
    """(n,) both, −1 where nothing is claimed."""
    certainty: Floats
    """(n,) probability that it is of that motion, given that it is of one of them; 1 if no other claims it."""
    together: float
    """The same of all of them."""


def image_claims(body: Candidate, own: Integers) -> Claims:
    """The claims of a motion among all detections, by its own matches (n,)."""
    model = body.model
    _, found, at = fit_assignments(model, own[None])
    if not len(found.log_odds):
        return Claims(own, np.zeros(len(own)), int((own >= 0).sum()))
    squared = at.squared_distances_from(model.target, model.sigma, found.covariance[0])
    squared[~at.seen[0]] = np.inf

    def log_odds(rows: Integers) -> Floats:
        poses = np.repeat(at.rotation, len(rows), axis=0), np.repeat(at.position, len(rows), axis=0)
        return weigh_poses(model, rows, *poses)[0].log_odds

    return _claims(own, squared, model.allowed, log_odds)


def space_claims(model: PointSetModel, own: Integers) -> Claims:
    """The claims of a motion among all targets, by its own matches (n,)."""
    if (own >= 0).sum() <= FEWEST:
        return Claims(own, np.zeros(len(own)), int((own >= 0).sum()))
    squared, variance = model.judge_one(own).fit.squares()
    return _claims(own, (squared / variance)[0], model.allowed, lambda rows: model.judged(rows).log_odds)


def _claims(own: Integers, squared: Floats, allowed: Bools | None, log_odds: Callable[[Integers], Floats]) -> Claims:
    """Claims by the log-odds of the own matches, without one of them each, and with one more each.

    ``squared``: (n, n') squared distances from where points are predicted, over their variances.
    """
    squared = squared if allowed is None else np.where(allowed, squared, np.inf)
    near = np.where(squared.min(axis=1) < GATE**2, squared.argmin(axis=1), -1)
    assignment = np.where(own >= 0, own, near)
    claimed = np.flatnonzero(assignment >= 0)
    rows = np.tile(own, (1 + len(claimed), 1))
    rows[1 + np.arange(len(claimed)), claimed] = np.where(own >= 0, -1, near)[claimed]
    every, gains = log_odds(rows), np.zeros(len(own))
    gains[claimed] = np.where(own[claimed] >= 0, 1.0, -1.0) * (every[0] - every[1:])
    return Claims(assignment, gains, int((own >= 0).sum()))


def allot_claims(claims: dict[int, Claims], n_target: int) -> SharedOut:
    """Each point and detection given to the motions so that their claims have the largest total, by label.

    The model of one motion takes what is of the others for points missed and for clutter; so each claim is worth more
    by what it costs to leave a point and a detection where all motions together leave few. How sure the shares are is
    the sum over all ways to share out, each with the product of the odds of its claims.
    """
    n = len(next(iter(claims.values())).assignment)
    i, j, gain, label = np.concatenate([one.rows(label) for label, one in claims.items()]).T
    i, j, label = i.astype(np.int64), j.astype(np.int64), label.astype(np.int64)
    total = min(sum(one.own for one in claims.values()), n, n_target)
    for which, one in claims.items():
        missed = (total + 1.0) / (n - total + 1.0) * (n - one.own + 1.0) / (one.own + 1.0)
        gain[label == which] += math.log(missed * (n_target - one.own + 0.5) / (n_target - total + 0.5))
    i, j, gain, label = i[gain > 0.0], j[gain > 0.0], gain[gain > 0.0], label[gain > 0.0]
    order = np.argsort(gain, kind="stable")
    worth, whose = np.zeros((n, n_target)), np.full((n, n_target), -1)
    worth[i[order], j[order]], whose[i[order], j[order]] = gain[order], label[order]
    assignment = maximise_total(worth, 0.0)
    matched, labels, certainty = np.flatnonzero(assignment >= 0), np.full(n, -1), np.ones(n)
    labels[matched] = whose[matched, assignment[matched]]
    own = (assignment[i] == j) & (labels[i] == label)
    told = sum_matchings_by_part(gain[None], i, j, 0.0)
    chance = told.marginals[0]
    either = np.bincount(told.rows, chance, n)[:, None] + np.bincount(told.columns, chance, n_target)
    np.subtract.at(either, (told.rows, told.columns), chance)  # of a point or a detection, each claim once
    for p, q, here, odds in zip(told.rows, told.columns, chance, told.log_odds[0], strict=True):
        if assignment[p] == q and worth[p, q] == odds:
            certainty[p] = here / either[p, q]
    together = math.exp(min(float(np.logaddexp(0.0, gain[own]).sum() - told.log_total[0]), 0.0))
    return SharedOut(assignment, labels, certainty, together)

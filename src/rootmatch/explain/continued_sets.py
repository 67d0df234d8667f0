"""What goes on by the law of a body that repeats itself, between two point sets: another lattice with the same spacing.

The places and the hypotheses are those of `rootmatch.explain.continued_bodies`; the evidence is that of
`rootmatch.model.point_set_model`, with places in the stead of points. Any share of them may be shown, or a window.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.explain.continued_bodies import LIKELY, continuation_factors, continue_body
from rootmatch.explain.more_places import MODES, Places
from rootmatch.model.labelling_sums import is_same_motion
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.point_set_posterior import PointSetPosterior
from rootmatch.model.prediction import GATE
from rootmatch.model.shown_regions import log_detection_count
from rootmatch.problems.points import PointClouds
from rootmatch.problems.pose_fit.point_set_fit import PointSetFit
from rootmatch.samplers.point_sets.congruent import grow_labellings

ROUNDS = 3
"""Rounds in which a motion is fitted to what is in its places. A round value."""


def allow_continued_sets(
    told: PointSetPosterior, model: PointSetModel, taken: Bools | None = None
) -> PointSetPosterior:
    """A posterior in which what goes on by a body's law may be beside it, or in its stead.

    ``taken``: (n',) targets of other bodies.
    """
    source = model.clouds.source
    if not told.shown >= LIKELY:
        return told
    flat = np.zeros((len(source), 3 - source.shape[1]))
    places = continue_body(np.concatenate([source, flat], axis=1), None)
    if not len(places.points):
        return told
    labels, first = np.full(len(told.assignments), -1), list[Integers]()
    while (labels < 0).any() and len(first) < MODES:
        best = int((labels < 0).argmax())
        own = (labels < 0) & is_same_motion(told.assignments, told.assignments[best], told.twins)
        own[best] = True
        labels[own] = len(first)
        first.append(told.assignments[best])
    of = labels >= 0
    beyond = _Continued(replace(model, prior=None, log_weights=None, allowed=None), places, taken)
    shares = np.maximum(np.bincount(labels[of], told.probabilities[of], len(first)), 1e-300)
    # of what has copies, the weight is not that of its own matches
    odds, mass = [beyond.odds(one) for one in first], np.log(shares) + told.log_total
    every = [None if one is None else (one[0] - m, one[1] - m) for one, m in zip(odds, mass, strict=True)]
    found = continuation_factors(every, shares, math.log(1.0 / model.present - 1.0))
    return told if found is None else told.beside(np.where(of, found[0][labels], 0.0), found[1])


class _Continued:
    """The model of a body with points in all places that its law leads to, and of those beyond it alone."""

    def __init__(self, model: PointSetModel, places: Places, taken: Bools | None) -> None:
        clouds, points = model.clouds, places.points[:, : model.clouds.source.shape[1]]
        self.body, self.beyond = model, places.beyond
        self.others = _with_places(clouds, points)
        self.whole = replace(model, clouds=_with_places(clouds, points, beside=True))
        self.outside = replace(model, clouds=_with_places(clouds, points[places.beyond]))
        self.free = np.ones(len(clouds.target), np.bool_) if taken is None else ~taken

    def odds(self, assignment: Integers) -> tuple[float, float] | None:
        """Log-odds, over clutter, of a labelling (n,) with what goes on beside it, and of something else in its stead.

        None where no target that it leaves is in any of the places.
        """
        checkpoint()
        one, left = self.body.judge_one(assignment), self.free.copy()
        left[assignment[assignment >= 0]] = False
        squared, variance = replace(one.fit, clouds=self.others).squares()
        if not (squared < GATE**2 * variance)[..., left].any():
            return None
        labels = np.append(assignment, np.full(len(self.beyond), -1))[None]
        clouds = self.whole.clouds
        allowed = None if self.free.all() else np.tile(self.free, (labels.shape[1], 1))
        for _ in range(ROUNDS):
            labels = grow_labellings(clouds, labels, self.body.mirror, allowed)
        found = self.whole.judge(labels)
        best = int(found.log_odds.argmax())
        instead = float(found.log_odds[best])
        more = labels[best, len(assignment) :]
        more = np.where(self.beyond & (more >= 0) & left[more], more, -1)
        if not (more >= 0).any():
            return -math.inf, instead
        both = self.whole.judge(np.concatenate([assignment, more])[None])
        outside = replace(both.fit, clouds=self.outside.clouds, assignments=more[None, self.beyond])
        shown = (
            _log_shown_chance(self.body, one.fit)
            + _log_shown_chance(self.outside, outside)
            - _log_shown_chance(self.whole, both.fit)
        )
        return float(both.log_odds[0]) + shown, instead


def _log_shown_chance(model: PointSetModel, fit: PointSetFit) -> float:
    """Part of the log-odds of a labelling that tells which of the points have a target, and where they are shown."""
    matched = (fit.assignments >= 0).sum(axis=1)
    shown = log_detection_count(len(model.clouds.source), matched, model.detection_rate)
    return float(shown[0] + np.logaddexp.reduce(model.log_factors(fit), axis=0)[0])


def _with_places(clouds: PointClouds, places: Floats, *, beside: bool = False) -> PointClouds:
    """The same targets with source points in places (m, k), as uncertain as the source's; ``beside`` its own or not."""
    known, m = clouds.source_covariance, len(places)
    variance = np.full(m, clouds.source_variance.mean())
    spread = None if known is None else np.tile(known.mean(axis=0), (m, 1, 1))
    if beside:
        places = np.concatenate([clouds.source, places])
        variance = np.concatenate([clouds.source_variance, variance])
        spread = None if known is None or spread is None else np.concatenate([known, spread])
    return clouds._replace(source=places, source_variance=variance, source_covariance=spread)

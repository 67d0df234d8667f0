"""The posterior of labellings of two point sets: those proposed, their neighbours, and clutter alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.frozen import copy_with
from rootmatch.model.labelling_sums import SHARED, LabellingSums, is_same_motion
from rootmatch.model.modes import used_mask
from rootmatch.model.point_set_alike import Likeness, weigh_likeness
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.priors import ALIKE, COPY, COUNTS, WRONG_MODEL
from rootmatch.model.weighed_labellings import Weighed, reflected_log_odds, weigh_labellings
from rootmatch.problems.pose_fit.point_set_fit import FEWEST
from rootmatch.samplers.point_sets.congruent import NEAR, reflected_labellings

REFLECTED = 4
"""Places of a copy in which a mirror image is looked for. A round value; it bounds time."""


@dataclass(frozen=True, eq=False)
class PointSetPosterior:
    """Hypotheses, the most probable first, and the confidence in each point of the first.

    Attributes
    ----------
    assignments : (K, n) int64 array
    probabilities : (K,) array
        Probability of each hypothesis; the remainder to 1 is clutter alone or a mirror image.
    sums : sequence of LabellingSums
        Over all labellings about some motions, of which the hypotheses are not nearly all: these have the probability
        of the motion.
    log_total : float
        Logarithm of the evidence of all hypotheses, clutter alone among them, against that of all targets as clutter.
    twins : (n', n') bool array, optional
        Which targets may be measurements of one place: see `is_same_motion`.
    copies : int
        How many of several bodies that were given are the same, with this one.
    """

    assignments: Integers
    probabilities: Floats
    sums: Sequence[LabellingSums] = ()
    log_total: float = 0.0
    twins: Bools | None = None
    copies: int = 1

    @cached_property
    def shown(self) -> float:
        """Probability that one of the hypotheses holds."""
        return float(self.probabilities.sum())

    @property
    def present(self) -> float:
        """Probability that the object is among the targets, or that one of its copies is where it may be."""
        own = self.shown
        if self.copies > 1 and len(self.probabilities):
            there = np.isin(self.assignments, self.assignments[0][self.assignments[0] >= 0]).any(axis=1)
            own = max(own, self.copies * float(self.probabilities[there].sum()))
        return min(own, 1.0 - WRONG_MODEL)

    @property
    def motion(self) -> float:
        """Probability of the motion of the first hypothesis, whatever its labels; 0 without any."""
        return float(self.probabilities[np.isfinite(self._odds)].sum()) if len(self.probabilities) else 0.0

    def used(self, count: int) -> Floats:
        """Probability (n',) that each of so many targets is of the object."""
        return np.asarray(self.probabilities @ used_mask(self.assignments, count))

    def without(self, taken: Bools) -> PointSetPosterior:
        """The same with the best hypothesis that takes none of the targets (n',) that are taken in the first place.

        Without any hypothesis if there is none.
        """
        free = np.flatnonzero(~(used_mask(self.assignments, len(taken)) & taken).any(axis=1))
        if len(free) and free[0] == 0:
            return self
        if not len(free):
            return PointSetPosterior(self.assignments[:0], self.probabilities[:0])
        order = np.concatenate([free[:1], np.delete(np.arange(len(self.probabilities)), free[0])])
        return copy_with(self, assignments=self.assignments[order], probabilities=self.probabilities[order])

    def beside(self, log_factors: Floats, log_other: float) -> PointSetPosterior:
        """The same with factors (K,) on the weights of hypotheses, and something else that takes its share.

        ``log_other``: logarithm of the weight of that, in the units of the probabilities.
        """
        top = max(float(log_factors.max(initial=0.0)), log_other)
        weights = self.probabilities * np.exp(log_factors - top)
        rest = max(1.0 - self.shown, 0.0) * math.exp(-top) + math.exp(log_other - top)
        whole = float(weights.sum()) + rest
        told = sort_hypotheses(self.assignments, weights / whole, self.sums, self.twins)
        return copy_with(told, log_total=self.log_total + top + math.log(whole), copies=self.copies)

    @property
    def probability(self) -> float:
        """Probability of the first hypothesis, as a whole."""
        kept = 1.0 if self._own_sums is None else self._own_sums[1]
        return kept * float(self.probabilities[0])

    @cached_property
    def confidence(self) -> tuple[Floats, Floats]:
        """Probability (n,) that each point's match, or its lack of one, is right; and that it has none."""
        first, odds = self.assignments[0], self._odds
        same = np.isfinite(odds)
        change, to_first = self.assignments[same] != first, np.append(1.0, odds[same][1:])[:, None]
        away = 1.0 + (to_first * change).sum(axis=0)
        none = (to_first * (self.assignments[same] < 0)).sum(axis=0)
        own, without = 1.0 / away, none / away
        if self._own_sums is not None:
            sums, _, more = self._own_sums
            own = np.clip(sums.weights @ sums.of_points(first) + more @ ~change, 0.0, 1.0)
            without = np.clip(sums.weights @ sums.unmatched + more @ (self.assignments[same] < 0), 0.0, 1.0)
        here, rest = float(self.probabilities[same].sum()), self.probabilities[~same]
        each = here * own + rest @ (self.assignments[~same] == first)
        unmatched = here * without + rest @ (self.assignments[~same] < 0)
        absent = max(1.0 - self.shown, 0.0)
        each = each + absent * (first < 0)
        return np.minimum(each, 1.0 - WRONG_MODEL), np.minimum(unmatched + absent, 1.0 - WRONG_MODEL)

    def drop_doubtful(self, required_probability: float) -> tuple[Integers, float] | None:
        """The first hypothesis without its least certain matches, and the probability that the rest is right.

        As many are kept as have the wanted probability together. None if fewer than half have their places with it, as
        have points of which it is uncertain which of two reports they have; or if the kept ones tell no motion.
        """
        first = self.assignments[0]
        matched = np.flatnonzero(first >= 0)
        order = matched[np.argsort(-self.confidence[0][matched], kind="stable")]
        targets = 1 + int(self.assignments.max()) if self.twins is None else len(self.twins)
        together = self._probabilities_together(order, np.arange(targets) == first[order, None])
        count = placed = int(np.count_nonzero(together >= required_probability))
        if self.twins is not None and count < len(order):
            in_place = self._probabilities_together(order, self.twins[first[order]])
            placed = int(np.count_nonzero(in_place >= required_probability))
        if count < FEWEST or placed <= SHARED * len(order):
            return None
        sure = np.full_like(first, -1)
        sure[order[:count]] = first[order[:count]]
        return sure, float(together[count - 1])

    def _probabilities_together(self, order: Integers, targets: Bools) -> Floats:
        """Probability (m,) that each of some points (m,) and all before it have any of some targets (m, n')."""
        same = np.isfinite(self._odds)
        here, labels = float(self.probabilities[same].sum()), self.assignments[same][:, order]
        other = (labels < 0) | ~targets[np.arange(len(order)), labels]
        begin = np.where(other.any(axis=1), other.argmax(axis=1), len(order))
        if self._own_sums is None:
            # local changes are taken as independent of each other
            lost = np.zeros(len(order) + 1)
            np.add.at(lost, begin, np.log1p(self._odds[same]))
            right = np.exp(-np.cumsum(lost[: len(order)]))
        else:
            # and so are the points, given the motion and the rates, but for what was weighed
            sums, _, more = self._own_sums
            every = sums.weights @ np.cumprod(sums.of_targets(order, targets), axis=1)
            right = np.minimum.accumulate(every + more @ (begin[:, None] > np.arange(len(order))))
        return np.minimum(here * right, 1.0 - WRONG_MODEL)

    @cached_property
    def _own_sums(self) -> tuple[LabellingSums, float, Floats] | None:
        """The sums about the first hypothesis' motion, how much of them hypotheses of that are, and what these add.

        Hypotheses were weighed by fits of their own. With what they add in the place of their shares of the sums, those
        are exact where hypotheses are all that counts.
        """
        own_sums = [one for one in self.sums if is_same_motion(one.about[None], self.assignments[0], self.twins)[0]]
        if not own_sums:
            return None
        sums = own_sums[0]
        same = np.isfinite(self._odds)
        shares, own = sums.shares(self.assignments[same]), self.probabilities[same]
        whole = min(float(shares.sum()), 1.0)
        return sums, whole, whole * own / max(float(own.sum()), 1e-300) - shares

    @cached_property
    def _odds(self) -> Floats:
        """Odds (K,) of each hypothesis against the first; 0 for itself, infinite for those of another motion."""
        same = is_same_motion(self.assignments, self.assignments[0], self.twins)
        odds = np.where(same, self.probabilities / max(float(self.probabilities[0]), 1e-300), np.inf)
        odds[0] = 0.0
        return odds


def weigh_point_set_posterior(
    model: PointSetModel, proposals: Judged, mirrored: Integers | None = None
) -> PointSetPosterior:
    """The posterior of what `weigh_labellings` tells of proposed labellings, and of clutter alone."""
    found = weigh_labellings(model, proposals, mirrored)
    if not len(found.assignments):
        return PointSetPosterior(found.assignments, found.log_mass)
    alike = weigh_likeness(model, proposals)
    mass = found.log_mass + _log_rival_factors(model, found, alike)
    absent = model.log_absent
    top = max(float(mass.max()), absent)
    weights = np.exp(mass - top)
    others = absent, found.log_mirrored, alike.log_odds + absent + model.log_unnamed
    whole = float(weights.sum()) + sum(math.exp(min(one - top, 700.0)) for one in others)
    told = sort_hypotheses(found.assignments, weights / whole, found.sums, model.twins)
    return copy_with(told, log_total=top + math.log(whole))


def mix_posteriors(parts: Sequence[PointSetPosterior]) -> PointSetPosterior:
    """One posterior of several models that are equally probable before targets are seen, by their evidence."""
    totals = np.array([one.log_total for one in parts])
    shares = np.exp(totals - np.logaddexp.reduce(totals))
    every = np.concatenate([one.assignments for one in parts])
    weights = np.concatenate([share * one.probabilities for share, one in zip(shares, parts, strict=True)])
    distinct, label = np.unique(every, axis=0, return_inverse=True)
    sums = [one for k in np.argsort(-shares, kind="stable") for one in parts[k].sums]
    weights = np.bincount(label.ravel(), weights, len(distinct)).astype(np.float64)
    told = sort_hypotheses(distinct, weights, sums, parts[0].twins)
    return copy_with(told, log_total=float(np.logaddexp.reduce(totals)))


def sort_hypotheses(
    assignments: Integers, probabilities: Floats, sums: Sequence[LabellingSums], twins: Bools | None
) -> PointSetPosterior:
    """The posterior of labellings (K, n) with their probabilities (K,)."""
    order = np.argsort(-probabilities, kind="stable")
    return PointSetPosterior(assignments[order], probabilities[order], sums, twins=twins)


def are_in_one_place(model: PointSetModel, assignments: Integers, asked: Bools) -> Bools:
    """Which of the labellings (K, n) move the source to one place within what is known of their motions.

    Where points are reported twice, either report explains them, and is no copy elsewhere. ``asked`` (K, K): of which
    two it is asked; of others it is said that they do not.
    """
    found = asked.copy()
    some = np.flatnonzero(asked.any(axis=0) | asked.any(axis=1))
    if len(some):
        moved, variance = model.fit(assignments[some]).places
        for k, one in enumerate(some):
            squared = ((moved - moved[k]) ** 2).sum(axis=2)
            found[one, some] &= (squared <= NEAR**2 * (variance + variance[k])).all(axis=1)
    return found


def _log_rival_factors(model: PointSetModel, found: Weighed, alike: Likeness) -> Floats:
    """Logarithms (K,) of factors by which what is beside a labelling changes its weight: a copy, or what is alike.

    Where two may be in the scene, either may be the one asked for, and a copy elsewhere, which nobody named, is weighed
    without what is known of the motion. It makes the first hypothesis no more probable. What a reflection has
    more of than a rotation is hardly a copy.
    """
    used = used_mask(found.assignments, len(model.clouds.target))
    of_copy = np.where(~(used @ used.T), found.log_odds + math.log(COPY), -np.inf)
    of_copy[are_in_one_place(model, found.assignments, of_copy > -COUNTS)] = -np.inf
    of_copy = np.concatenate([of_copy, _log_mirror_images_beside(model, found, of_copy[0], used)], axis=1)
    copies = np.logaddexp(0.0, np.logaddexp.reduce(of_copy, axis=1))
    more = alike.log_factors(found.assignments)
    own = more > 0.0
    copies[own] = np.logaddexp(copies[own], np.log(np.expm1(more[own])))
    return np.asarray(copies - np.logaddexp(0.0, np.logaddexp.reduce(of_copy[0])))


def _log_mirror_images_beside(model: PointSetModel, found: Weighed, of_copy: Floats, used: Bools) -> Floats:
    """Log-odds (K, M) of mirror images beside the labellings, in the places of copies (K,) beside the first one.

    Without those of what the labellings use themselves, of targets (K, n').
    """
    (asked,) = (of_copy > -COUNTS).nonzero()
    asked = asked[np.argsort(-of_copy[asked], kind="stable")[:REFLECTED]]
    every = [reflected_labellings(model.clouds, found.assignments[k], model.allowed) for k in asked.tolist()]
    labels = np.unique(np.concatenate([*every, found.assignments[:0]]), axis=0)
    if not len(labels):
        return np.empty((len(used), 0))
    log_odds = reflected_log_odds(replace(model, prior=None), labels)
    apart = ~(used @ used_mask(labels, used.shape[1]).T)
    return np.where(apart, log_odds + math.log(ALIKE), -np.inf)

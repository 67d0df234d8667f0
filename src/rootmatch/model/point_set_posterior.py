"""The posterior of labellings of two point sets: those proposed, their neighbours, and clutter alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.hypergraph.assignment import apart_from
from rootmatch.hypergraph.neighbourhood import Changes, likely_changes
from rootmatch.model.exact_symmetry import exactly_symmetric
from rootmatch.model.modes import uses_of
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.priors import COPY, COUNTS, WRONG_MODEL

MIRRORED = 0.01
"""Prior probability that the targets are a mirror image of the object, because an axis is flipped or a frame is
left-handed, although no reflection was asked for. If that explains them, nothing is trusted. A round value."""
KEPT = 64
"""Largest number of hypotheses whose shares are summed, and of those elsewhere. A round value."""
NEGLIGIBLE = 12.0
"""Log-odds against the best hypothesis beyond which a hypothesis is ignored. A round value."""
WORTH = 5.0
"""Log-odds against the best hypothesis up to which a hypothesis' neighbours are weighed. A round value."""
ROUNDS = 3
"""Largest number of rounds of weighing neighbours. A round value."""
EXPANDED = 6
"""Hypotheses whose neighbours are weighed in each round. A round value."""
CHANGES = 64
"""Number of changes of a hypothesis that are weighed, the most probable ones. A round value."""
LEADING = 0.01
"""Share of the best hypothesis above which hypotheses are tested for exchange by a self-motion."""
SYMMETRIC = 48
"""Largest number of pairs of hypotheses that are tested in this way. A round value."""
SHARED = 0.5
"""Fraction of its matches that a hypothesis of the same motion has in common with another one. A round value, as in
`rootmatch.explain.confidence`."""


@dataclass(frozen=True, eq=False)
class PointSetPosterior:
    """Hypotheses, the most probable first, and the confidence in each point of the first.

    Attributes
    ----------
    assignments : (K, n) int64 array
    probabilities : (K,) array
        Probability of each hypothesis; the remainder to 1 is clutter alone or a mirror image.
    """

    assignments: Integers
    probabilities: Floats

    @property
    def present(self) -> float:
        """Probability that the object is among the targets."""
        return min(float(self.probabilities.sum()), 1.0 - WRONG_MODEL)

    @property
    def motion(self) -> float:
        """Probability of the motion of the first hypothesis, whatever its labels; 0 without any."""
        return float(self.probabilities[np.isfinite(self._odds)].sum()) if len(self.probabilities) else 0.0

    def used(self, count: int) -> Floats:
        """Probability (n',) that each of so many targets is of the object."""
        return np.asarray(self.probabilities @ uses_of(self.assignments, count))

    def without(self, taken: Bools) -> PointSetPosterior:
        """The same with the best hypothesis that takes none of the targets (n',) that are taken in the first place.

        Without any hypothesis if there is none.
        """
        free = np.flatnonzero(~(uses_of(self.assignments, len(taken)) & taken).any(axis=1))
        if len(free) and free[0] == 0:
            return self
        if not len(free):
            return PointSetPosterior(self.assignments[:0], self.probabilities[:0])
        order = np.concatenate([free[:1], np.delete(np.arange(len(self.probabilities)), free[0])])
        return PointSetPosterior(self.assignments[order], self.probabilities[order])

    @cached_property
    def confidence(self) -> tuple[Floats, Floats]:
        """Probability (n,) that each point's match, or its lack of one, is right; and that it has none."""
        first, odds = self.assignments[0], self._odds
        same = np.isfinite(odds)
        change = self.assignments[same] != first
        away = 1.0 + (odds[same, None] * change).sum(axis=0)
        none = ((self.assignments[same] < 0) * np.where(np.arange(same.sum()) == 0, 1.0, odds[same])[:, None]).sum(
            axis=0
        )
        here, rest = float(self.probabilities[same].sum()), self.probabilities[~same]
        each = here / away + rest @ (self.assignments[~same] == first)
        unmatched = here * none / away + rest @ (self.assignments[~same] < 0)
        absent = max(1.0 - float(self.probabilities.sum()), 0.0)
        each = each + absent * (first < 0)
        return np.minimum(each, 1.0 - WRONG_MODEL), np.minimum(unmatched + absent, 1.0 - WRONG_MODEL)

    def sure(self, least_probability: float, least_matches: int) -> tuple[Integers, float] | None:
        """The first hypothesis without its least certain matches, and the probability that the rest is right.

        As many are kept as have the wanted probability together; None if that is fewer than half, or than the number.
        """
        first = self.assignments[0]
        matched = np.flatnonzero(first >= 0)
        order = matched[np.argsort(-self.confidence[0][matched], kind="stable")]
        odds = self._odds
        same = np.isfinite(odds)
        same[0] = False
        here = float(self.probabilities[np.isfinite(odds)].sum())
        touched = (self.assignments[same] != first)[:, order]
        # local changes are taken as independent of each other
        begin = np.where(touched.any(axis=1), touched.argmax(axis=1), len(order))
        lost = np.zeros(len(order) + 1)
        np.add.at(lost, begin, np.log1p(odds[same]))
        together = np.minimum(here * np.exp(-np.cumsum(lost[: len(order)])), 1.0 - WRONG_MODEL)
        count = int(np.count_nonzero(together >= least_probability))
        if count < least_matches or count <= SHARED * len(order):
            return None
        sure = np.full_like(first, -1)
        sure[order[:count]] = first[order[:count]]
        return sure, float(together[count - 1])

    @cached_property
    def _odds(self) -> Floats:
        """Odds (K,) of each hypothesis against the first; 0 for itself, infinite for those of another motion."""
        first = self.assignments[0]
        common = ((self.assignments == first) & (first >= 0)).sum(axis=1)
        same = common >= SHARED * max(int((first >= 0).sum()), 1)
        odds = np.where(same, self.probabilities / max(float(self.probabilities[0]), 1e-300), np.inf)
        odds[0] = 0.0
        return odds


class Weighed(NamedTuple):
    """Labellings of one body, the best one first, weighed against clutter alone.

    Attributes
    ----------
    assignments : (K, n) int64
    log_odds : (K,) float64
        Of each by itself, without what is known of the motion.
    log_mass : (K,) float64
        With it, and with what a self-motion of the source makes equal.
    mirrored : (n,) int64, optional
        The best labelling by a reflection, which is no answer.
    log_mirrored : float
        Its log-odds, prior included.
    """

    assignments: Integers
    log_odds: Floats
    log_mass: Floats
    mirrored: Integers | None
    log_mirrored: float

    def take(self, which: Integers) -> Weighed:
        """Some of the labellings."""
        return self._replace(**{name: getattr(self, name)[which] for name in ("assignments", "log_odds", "log_mass")})


def posterior(model: PointSetModel, proposals: Integers, mirrored: Integers | None = None) -> PointSetPosterior:
    """The posterior of proposed labellings (K, n), their neighbours by one change, and clutter alone.

    See `weighed`; ``mirrored`` as there.
    """
    found = weighed(model, proposals, mirrored)
    if not len(found.assignments):
        return PointSetPosterior(found.assignments, found.log_mass)
    absent = math.log(1.0 / model.present - 1.0)
    top = max(float(found.log_mass[0]), absent)
    weights = np.exp(found.log_mass - top) * _with_copies(model, found.assignments, found.log_odds)
    other = math.exp(absent - top) + math.exp(min(found.log_mirrored - top, 700.0))
    return ordered(found.assignments, weights / (weights.sum() + other))


def nothing_weighed(n: int) -> Weighed:
    """No labelling of n points."""
    return Weighed(np.empty((0, n), np.int64), np.empty(0), np.empty(0), None, -math.inf)


def ordered(assignments: Integers, probabilities: Floats) -> PointSetPosterior:
    """The posterior of labellings (K, n) with their probabilities (K,)."""
    order = np.argsort(-probabilities, kind="stable")
    return PointSetPosterior(assignments[order], probabilities[order])


def weighed(
    model: PointSetModel, proposals: Integers, mirrored: Integers | None = None, *, of_several: bool = False
) -> Weighed:
    """Proposed labellings (K, n) and their neighbours by one change, the best ones of them.

    Neighbours are weighed by fits of their own. Labellings that a self-motion of the source exchanges become equally
    probable to the degree that the source is exactly symmetric under it. ``mirrored``: labellings (M, n) by
    reflections, which are not answers. ``of_several``: whether other bodies may take what the best ones need.

    Raises
    ------
    OutOfTime
        If the deadline in force passes: without its neighbours a labelling would look more certain than it is.
    """
    proposals = proposals[(proposals >= 0).sum(axis=1) >= 3]
    if not len(proposals):
        return nothing_weighed(len(model.clouds.source))
    checkpoint()
    found = _best(model.judged(proposals), of_several)
    known_ones = {one.tobytes() for one in found.fit.assignments}
    expanded: set[bytes] = set()
    for _ in range(ROUNDS):
        fit, odds = found.fit, found.log_odds
        likely = np.argsort(-odds, kind="stable")[: np.count_nonzero(odds > odds.max() - WORTH)].tolist()
        waiting = [k for k in likely if fit.assignments[k].tobytes() not in expanded][:EXPANDED]
        new: list[Integers] = []
        for k in waiting:
            checkpoint()
            one = fit.assignments[k]
            expanded.add(one.tobytes())
            changes, gains = likely_changes(one, model.gains(fit, k), odds.max() - odds[k] - NEGLIGIBLE)
            some = np.argsort(-gains, kind="stable")[:CHANGES]
            better = changes.take(some[gains[some] > 0.0])
            for other in (*changes.take(some).applied_to(one), _changed_at_once(one, better)):
                if other.tobytes() not in known_ones and (other >= 0).sum() >= 3:
                    known_ones.add(other.tobytes())
                    new.append(other)
        if not new:
            break
        found = found.joined(model.judged(np.array(new)))
    found = _best(found, of_several)
    model.keep(found.take(np.arange(1)))
    assignments, known = found.fit.assignments, found.known  # which tells symmetric motions from each other
    odds = found.log_odds - known
    most = float(odds.max())
    equal = _exchanged(model, assignments, np.exp(odds - most))
    mass = np.log(np.maximum(equal, 1e-300)) + known + most
    return Weighed(assignments, odds, mass, *_mirrored(model, mirrored, assignments, found.log_odds))


def _with_copies(model: PointSetModel, assignments: Integers, odds: Floats) -> Floats:
    """Factors (K,) by which a copy of the object elsewhere, which nobody named, changes the weights of hypotheses.

    Where two may be in the scene, either may be the one asked for. ``odds`` (K,): without what is known of the motion,
    which tells nothing of a copy. The first hypothesis has the factor 1.
    """
    used = uses_of(assignments, len(model.clouds.target))
    apart = ~(used @ used.T)
    if not apart.any():
        return np.ones(len(odds))
    of_copy = np.where(apart, odds + math.log(COPY), -np.inf)
    highest = np.maximum(of_copy.max(axis=1), 0.0)
    factors = highest + np.log(np.exp(-highest) + np.exp(of_copy - highest[:, None]).sum(axis=1))
    return np.asarray(np.exp(np.minimum(factors - factors[0], 700.0)))


def _changed_at_once(assignment: Integers, changes: Changes) -> Integers:
    """An assignment with as many of some changes, the best first, as do not concern the same points or targets."""
    changed, touched = assignment.copy(), np.zeros(len(assignment), np.bool_)
    for row in zip(*changes, strict=True):
        points = [point for point in row[::2] if point >= 0]
        new = [target for target in row[1::2] if target >= 0]
        others = np.delete(changed, points)
        if not touched[points].any() and not np.isin(new, others).any():
            changed[points], touched[points] = row[1 : 2 * len(points) : 2], True
    return changed


def _best(found: Judged, of_several: bool) -> Judged:
    """The best hypotheses that are not negligible, and those of a copy, the best one first.

    Of several bodies, all that are better than clutter: others may take what a better one needs.
    """
    odds, assignments = found.log_odds, found.fit.assignments
    if len(odds) == 1:
        return found
    order = np.argsort(-odds, kind="stable")
    least = 0.0 if of_several else -math.log(COPY)
    apart = apart_from(assignments[order], assignments[order[0]]) & (odds[order] > least - COUNTS)
    near = (odds[order] > odds[order[0]] - 2.0 * NEGLIGIBLE) & (np.arange(len(order)) < KEPT)
    if of_several:
        near |= (odds[order] > 0.0) & (np.arange(len(order)) < KEPT)
    order = order[near | (apart & (np.cumsum(apart & ~near) <= KEPT))]
    return found.take(order)


def _mirrored(
    model: PointSetModel, mirrored: Integers | None, assignments: Integers, odds: Floats
) -> tuple[Integers | None, float]:
    """The best mirror image and its log-odds, prior included.

    Points nearly in a plane fit a reflection as well as a rotation; with the same labels, a reflection is no different
    answer.
    """
    if mirrored is None or not len(mirrored):
        return None, -math.inf
    image = replace(model, mirror=True)
    weight = image.judged(mirrored).log_odds + math.log(MIRRORED)
    for one, value in zip(assignments, odds, strict=True):
        weight[(mirrored == one).all(axis=1) & (weight < value + NEGLIGIBLE)] = -np.inf
    best = int(np.argmax(weight))
    return mirrored[best], float(weight[best])


def _exchanged(model: PointSetModel, assignments: Integers, weights: Floats) -> Floats:
    """Weights (K,) of hypotheses, those that a self-motion of the source exchanges as equal as it is probably exact."""
    mixing = np.eye(len(assignments))
    least = math.exp(-NEGLIGIBLE) * float(weights.max())
    used = [frozenset(one[one >= 0].tolist()) for one in assignments]
    looked_at = 0
    for a, b in combinations(range(len(assignments)), 2):
        if used[a] != used[b] or weights[b] < least or weights[a] < LEADING * float(weights.max()):
            continue
        if looked_at == SYMMETRIC:
            break
        looked_at += 1
        checkpoint()
        # the point that one labelling assigns to a target takes the place of the other's point
        first, second = (
            np.argsort(one, kind="stable")[int((one < 0).sum()) :] for one in (assignments[a], assignments[b])
        )
        mixing[a, b] = mixing[b, a] = exactly_symmetric(model.clouds, first, second, model.mirror)
    return np.asarray((mixing / mixing.sum(axis=1, keepdims=True)) @ weights)

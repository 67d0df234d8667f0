"""The posterior of one body: over the poses that were proposed, and clutter alone.

The probability of an assignment is never above that of its pose, nor above the confidence in any of its matches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.frozen import once
from rootmatch.model.modes import Modes, empty_modes
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.model.shown_in_part import FewShown

WRONG = 0.001
"""Part of the matches of a large assignment that may be expected to be wrong. A round value."""


class Believed(NamedTuple):
    """What is believed of an assignment."""

    assignment: Integers
    """(n,) of the matches that are right together, all but a few of a large assignment, with the least probability."""
    probability: float
    """That they are, at least."""
    known: int
    """Matches that are known, of which so few are expected to be wrong."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of one body, given its image.

    Attributes
    ----------
    modes : Modes
    probabilities : (M,) float64
        Of each mode's pose, whatever its matches.
    clutter : float
        Probability that the image does not show the body, or shows too little of it to recognise it.
    few : FewShown, optional
        What tells how probably it shows too little; it is taken to be absent without.
    exchanged : (M,) bool array, optional
        Which modes are where another body of its family was expected; none if not given.
    origins : (M,) int array, optional
        Which prediction each mode is about, −1 for none; see `rootmatch.model.pose_density.Doubted.prediction_indices`.
    copy : float
        Part of ``clutter`` in which the modes are those of a copy of the body.
    copies : int
        How many bodies are weighed alike, this one among them: the name of each is a convention.
    """

    modes: Modes
    probabilities: Floats
    clutter: float
    few: FewShown | None = None
    exchanged: Bools | None = None
    origins: Integers | None = None
    copy: float = 0.0
    copies: int = 1

    @once
    def undetected_probability(self) -> Floats | float:
        """Probability (n,) that each point has no detection, if the image shows no mode."""
        return 1.0 if self.few is None else self.few.undetected_probability()

    @once
    def shown(self) -> float:
        """Probability that the image shows one of the modes."""
        return float(self.probabilities.sum())

    def assignment_probability(self, assignment: Integers) -> float:
        """Probability of an assignment (n,), summed over the poses that have it."""
        same = (self.modes.assignments == assignment).all(axis=1)
        shares = np.exp(np.minimum(self.modes.log_odds - self.modes.log_mass, 0.0))
        return float(self.probabilities @ (same * shares))

    @once
    def confidence(self) -> Floats:
        """Probability (n,) that each point's match in the first mode is right or, if unmatched, that it has none."""
        return self.confidence_in(self.modes.assignments[0])

    def confidence_in(self, assignment: Integers) -> Floats:
        """`confidence` in any assignment (n,)."""
        unmatched = assignment < 0
        each = np.where(self.modes.assignments == assignment, self.modes.local, unmatched * self.modes.unmatched)
        return np.asarray(self.probabilities @ each + unmatched * (self.clutter * self.undetected_probability))

    def present(self, mode: int = 0) -> float:
        """Probability that the body is in view, or that one of its copies is where one of its modes has it."""
        own = self.shown
        if self.copies == 1 or not len(self.probabilities):
            return own
        matched = self.modes.assignments[mode][self.modes.assignments[mode] >= 0]
        there = np.isin(self.modes.assignments, matched).any(axis=1)
        return max(own, min(self.copies * float(self.probabilities[there].sum()), 1.0 - WRONG_MODEL))

    @property
    def unmatched(self) -> Floats:
        """Probability (n,) that each point has no detection."""
        return np.asarray(self.probabilities @ self.modes.unmatched + self.clutter * self.undetected_probability)

    def used(self, count: int) -> Floats:
        """Probability (n',) that each of so many detections is of the body."""
        return np.asarray(self.probabilities @ self.modes.uses(count))

    def beside(self, log_factors: Floats, log_other: float) -> Posterior:
        """The same with factors on the weights of the first modes (m,), and something else that takes its share.

        ``log_other``: logarithm of the weight of that, in the units of the probabilities.
        """
        more = np.zeros(len(self.probabilities))
        more[: len(log_factors)] = log_factors
        top = max(float(more.max(initial=0.0)), log_other)
        weights = self.probabilities * np.exp(more - top)
        clutter = self.clutter * math.exp(-top) + math.exp(log_other - top)
        whole = (self.shown + self.clutter) / (float(weights.sum()) + clutter)
        order = np.argsort(-weights, kind="stable")
        exchanged = None if self.exchanged is None else self.exchanged[order]
        origins = None if self.origins is None else self.origins[order]
        return Posterior(
            self.modes.take(order), whole * weights[order], whole * clutter, self.few, exchanged,
            origins=origins, copy=whole * self.copy * math.exp(-top), copies=self.copies,
        )  # fmt: skip

    def ranked(self, maximum: int) -> list[tuple[Integers, float]]:
        """Different assignments with their probabilities: those of the modes, and changes of them that were weighed."""
        modes = self.modes
        rows, odds, mode = [modes.assignments], [modes.log_odds], [np.arange(len(modes.log_odds))]
        for k, (changed, values, _) in enumerate(modes.near):
            rows.append(changed)
            odds.append(values)
            mode.append(np.full(len(values), k))
        every, of = np.concatenate(rows), np.concatenate(mode)
        shares = self.probabilities[of] * np.exp(np.minimum(np.concatenate(odds) - modes.log_mass[of], 0.0))
        total: dict[bytes, float] = {}
        place: dict[bytes, int] = {}
        for k in np.argsort(-shares, kind="stable")[: 4 * maximum].tolist():
            key = every[k].tobytes()
            total[key] = total.get(key, 0.0) + float(shares[k])
            place.setdefault(key, k)
        return [(every[place[key]], total[key]) for key in sorted(total, key=lambda key: -total[key])[:maximum]]

    def believe(self, min_probability: float, lit: Floats | float = 1.0) -> Believed | None:
        """The first assignment without its doubtful matches; None if its pose has not the least probability.

        If that is p and the pose's P, its `surest_matches` are known with 1 − p / P. ``lit`` (n,) is the probability
        that a point is lit, given that its blob has the detection.
        """
        if not len(self.probabilities):
            return None
        pose = float(self.probabilities[0])
        if pose < min_probability:
            return None
        first: Integers = self.modes.assignments[0]
        matched = (first >= 0).nonzero()[0]
        sure = float(self.confidence[matched].max())
        return drop_doubtful_matches(first, self.confidence * lit, sure, min_probability, pose=pose)


@dataclass(frozen=True, eq=False)
class Others(Sequence[Integers]):
    """The most probable assignments of a posterior, ranked when they are first read.

    Attributes
    ----------
    told : Posterior
    maximum : int
        How many there are at most.
    than : (n,) int64, optional
        From which all are different; if it is not given, there may be one more.
    """

    told: Posterior
    maximum: int
    than: Integers | None = None

    @once
    def ranked(self) -> list[tuple[Integers, float]]:
        """The assignments with their probabilities, the most probable first."""
        every = self.told.ranked(1 + self.maximum)
        if self.than is None:
            return every
        # an assignment that merely leaves out some of the points is not a different one
        different = [(one, chance) for one, chance in every if ((one >= 0) & (one != self.than)).any()]
        return different[: self.maximum]

    @once
    def assignments(self) -> list[Integers]:
        """The assignments alone."""
        return [one for one, _ in self.ranked]

    def __len__(self) -> int:
        return len(self.ranked)

    def __getitem__(self, k: Any) -> Any:
        return self.assignments[k]


def surest_matches(confidence: Floats, wrong: float) -> Integers:
    """The most certain of m matches (places in ``confidence``, (m,)), the surest first.

    As many as leave the expected number of wrong ones at most ``wrong``, or `WRONG` of the m of a large assignment.
    """
    order = (-confidence).argsort(kind="stable")
    return np.asarray(order[(1.0 - confidence[order]).cumsum() <= max(wrong, WRONG * len(confidence))])


def drop_doubtful_matches(
    assignment: Integers, confidence: Floats, sure: float, min_probability: float, *, pose: float
) -> Believed:
    """What is believed of an assignment (n,): its matches that are right together with the least probability.

    ``confidence`` (n,): probability of each match; ``sure``: that of a match of which nothing but the pose is doubtful;
    ``pose``: probability of the pose, at least ``min_probability``.
    """
    matched = (assignment >= 0).nonzero()[0]
    each = confidence[matched]
    given_pose = each / sure
    known = surest_matches(given_pose, 1.0 - min_probability / pose)
    together = np.minimum(pose * joint_probabilities(given_pose[known], min_probability), each[known])
    count = int(np.count_nonzero(together >= min_probability))
    kept, out = matched[known[:count]], np.full(len(assignment), -1)
    out[kept] = assignment[kept]
    return Believed(out, float(together[count - 1]) if count else pose, len(known))


def joint_probabilities(confidence: Floats, min_probability: float) -> Floats:
    """Probability (m,), at least, that of the first 1, 2, … of m matches all are right.

    Of so many that a thousandth of them is more than may be wrong by ``min_probability``, all but that, rounded up.
    """
    expected = (1.0 - confidence).cumsum()
    if WRONG * len(confidence) <= 1.0 - min_probability:
        return np.asarray(1.0 - expected)
    from scipy.special import pdtr  # slow to import

    allowed = WRONG * np.arange(1, len(confidence) + 1)
    few = pdtr(np.ceil(allowed), expected)  # a sum of independent events is spread less than a Poisson distribution
    return np.asarray(np.where(allowed > 1.0 - min_probability, few, 1.0 - expected))


def empty_posterior(n: int) -> Posterior:
    """The posterior of a body of n points for which nothing was proposed."""
    return Posterior(empty_modes(n), np.empty(0), 1.0 - WRONG_MODEL)

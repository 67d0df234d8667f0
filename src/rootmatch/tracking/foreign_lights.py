"""Lights beside a followed body that were taken for its points.

A light that was taken for a point moves the prediction with it, so the next frame finds it where it is expected,
whatever it is. Frames therefore do not add to what the first one told of a match, but by the image alone: the other
matches say where its point is. With three or four of them that is a test, with two it is none.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.explain.finding import Finding
from rootmatch.model.detection_model import USUAL_RATE
from rootmatch.model.evidence import weigh_assignments
from rootmatch.model.pose_density import Doubted
from rootmatch.model.priors import WRONG_MODEL, log_chance
from rootmatch.tracking.mistaken_identity import STAYS

RECENT = 0.25
"""Seconds for which a match takes part in the prediction. A round value."""
DETERMINE = 3
"""Number of matches that determine a pose."""
LIT = 0.8
"""Probability that a point is lit of which nothing is known. A round value."""
TOGETHER = 0.1
"""Probability that points which were dark are lit again together, as what covered them is gone. A round value."""
AGREE = 5
"""Number of matches from which some are right: that two fit a pose of three others is no accident. A round value."""
SURE = 0.99
"""Probability from which a match is not asked for again. A round value."""


class ForeignLights:
    """How probably the last match of each point, or of each of its sightings by a rig, was not of something else."""

    def __init__(self, count: int) -> None:
        self.own, self.met, self.seen = np.ones(count), np.ones(count), np.full(count, -math.inf)
        """Probability (n,) that the last match was right; that the point was lit when it was met; its time."""
        self.time = self.since = -math.inf
        """Of the last frame; of the first one in which it was found again after frames that did not show the body."""
        self._maximum: tuple[Finding, float, Floats] | None = None

    @property
    def holds(self) -> float:
        """Probability that the last pose was that of the body: that the right matches determine it."""
        each: list[float] = self.own[self.seen >= max(self.time - RECENT, self.since)].tolist()
        if len(each) <= DETERMINE:
            return math.prod(each)
        none, one, two = 1.0, 0.0, 0.0  # probability of so few right ones, of what `DETERMINE` is more
        for own in each:
            wrong = 1.0 - own
            none, one, two = wrong * none, wrong * one + own * none, wrong * two + own * one
        return 1.0 - none - one - two

    def _current_probability(self, chance: Floats, time: float) -> Floats:
        """Probabilities (n,) at a time: what was beside the body may have left since the last match."""
        gone = np.where(self.seen < self.time, (time - self.seen) / STAYS, 0.0)
        return np.asarray(1.0 - (1.0 - chance) * np.exp(-gone))

    def maximum(self, found: Finding, lit: Floats, time: float) -> Floats:
        """The largest probability (n,) that each match of a finding can have, given its pose.

        ``lit`` (n,): probability that each point is lit at that time.
        """
        if self._maximum is not None:
            last, when, maximum = self._maximum
            same = last.posterior is found.posterior and last.mode == found.mode
            if same and last.assignment is found.assignment and when == time:
                return maximum
        own = self._current_probability(self.own, time)
        doubtful = ((found.assignment >= 0) & (own < SURE)).nonzero()[0]
        if len(doubtful):
            before = np.minimum(self._current_probability(self.met, time), lit)
            own[doubtful] = np.maximum(own[doubtful], doubtful_probability(found, doubtful, before))
        maximum = np.where(own < SURE, own, 1.0)
        self._maximum = found, time, maximum  # asked for as the frame is weighed, and as it is learned from
        return maximum

    def take(self, found: Finding, given: Floats, lit: Floats, time: float) -> None:
        """Learn from a frame.

        ``given``: (n,) probability of each match, given the pose; ``lit``: (n,) that each point is lit, before the
        frame was seen.
        """
        matched, met = found.assignment >= 0, self._current_probability(self.met, time)
        met = np.where(self.seen < self.time, np.minimum(met, lit), met)
        given = np.minimum(given, self.maximum(found, lit, time))
        if found.posterior is not None and len(found.posterior.probabilities) > 1:
            modes = found.posterior.modes.take(slice(len(found.posterior.probabilities)))
            # what is one of several poses now, may be the only one in a moment
            other = found.posterior.probabilities @ (modes.local * (modes.assignments >= 0))
            possible = ~matched & (other > WRONG_MODEL)
            given = np.where(possible, np.minimum(other, self._current_probability(self.own, time)), given)
            matched = matched | possible
        self.own, self.met = np.where(matched, given, self.own), np.where(matched, met, self.met)
        self.seen, self.time = np.where(matched, time, self.seen), time
        self._maximum = None


def doubtful_probability(found: Finding, doubtful: Integers, lit: Floats) -> Floats:
    """Probability (m,) of the doubtful matches by the image alone: the prediction has them in it.

    Summed are all of them, all but one, one beside the sure matches, and these alone. Where only as many match as
    determine a pose, nothing tells of any: 0. ``lit``: (n,) probability of light, as far as the image does not tell.
    """
    (told, model), count = found.posterior_and_model, found.matched_count
    if count <= DETERMINE:
        return np.zeros(len(doubtful))
    right, modes, k = _right_patterns(len(doubtful)), told.modes, slice(found.mode, found.mode + 1)
    if count >= AGREE:
        right = right[count - (~right).sum(axis=1) >= DETERMINE]
    assignments = np.tile(found.assignment, (len(right), 1))
    assignments[:, doubtful] = np.where(right, found.assignment[doubtful], -1)
    at = model.linearise_about(modes.rotation[k], modes.position[k])
    prior = model.prior.without if isinstance(model.prior, Doubted) else model.prior
    weight = weigh_assignments(model, assignments, at, prior).log_odds
    each = [_log_chance(found, right, doubtful, one) for one in (lit, np.full(len(lit), LIT))]
    weight += np.logaddexp(each[0] + math.log1p(-TOGETHER), each[1] + math.log(TOGETHER))
    if not math.isfinite(maximum := float(weight.max())):
        return np.zeros(len(doubtful))
    weight = np.exp(weight - maximum)
    return np.asarray(weight @ right / weight.sum())


def _log_chance(found: Finding, right: Bools, points: Integers, lit: Floats) -> Floats:
    """Log-probability (K,) of which matches are right (K, m), by the probability (n,) that each point is lit."""
    dark = np.log(missed(found, lit)[points])
    return np.asarray(np.where(right, log_chance(lit[points]), dark).sum(axis=1))


def _right_patterns(count: int) -> Bools:
    """Which of so many matches are right (K, count): all, none, one, or all but one."""
    one = np.eye(count, dtype=np.bool_)
    each = [np.ones((1, count), np.bool_), np.zeros((1, count), np.bool_), *[one][: count - 1], *[~one][: count - 2]]
    return np.concatenate(each)


def rates(found: Finding) -> Floats:
    """Probability (n,) that each point is detected if it is lit, in the pose of a finding."""
    assert found.posterior is not None
    visible: Floats = found.posterior.modes.visible[found.mode]
    return (found.task.options.detection_rate or USUAL_RATE) * visible


def missed(found: Finding, lit: Floats) -> Floats:
    """How much more probably (n,) each point is not detected if it is lit with a probability than if it is lit."""
    rate = rates(found)
    return np.asarray(np.maximum(1.0 - rate * lit, 1e-300) / np.maximum(1.0 - rate, 1e-300))

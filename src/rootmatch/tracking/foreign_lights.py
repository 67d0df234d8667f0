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
from rootmatch.model.evidence import evidence
from rootmatch.model.pose_density import Doubted
from rootmatch.model.posterior import Posterior
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.tracking.two_states import log_chance

STAYS = 1.0
"""Seconds within which something else beside the body leaves its place. A round value, that of a body."""
RECENT = 0.25
"""Seconds for which a match takes part in the prediction. A round value."""
DETERMINE = 3
"""Number of matches that determine a pose."""
SURE = 0.99
"""Probability from which a match is not asked for again. A round value."""


class ForeignLights:
    """How probably the last match of each point was not that of something else.

    Parameters
    ----------
    count : int
        Number n of the points, or of their sightings by a rig.
    """

    def __init__(self, count: int) -> None:
        self.own, self.met, self.seen = np.ones(count), np.ones(count), np.full(count, -math.inf)
        """Probability (n,) that the last match was right; that by which points were lit when it was met; its time."""
        self.time = -math.inf

    @property
    def holds(self) -> float:
        """Probability that the last pose was that of the body: that the right matches determine it."""
        each = self.own[self.seen >= self.time - RECENT].tolist()
        count = np.zeros(min(DETERMINE, len(each)) + 1)  # probability of so many right ones, or more for the last
        count[0] = 1.0
        for own in each:
            more = own * count[:-1]
            count[:-1] -= more
            count[1:] += more
        return float(count[-1])

    def _now(self, chance: Floats, time: float) -> Floats:
        """Probabilities (n,) at a time: what was beside the body may have left since the last match."""
        gone = np.where(self.seen < self.time, (time - self.seen) / STAYS, 0.0)
        return np.asarray(1.0 - (1.0 - chance) * np.exp(-gone))

    def most(self, found: Finding, lit: Floats, time: float) -> Floats:
        """The largest probability (n,) that each match of a finding can have, given its pose.

        ``lit`` (n,): probability that each point is lit.
        """
        own = self._now(self.own, time)
        doubtful = np.flatnonzero((found.assignment >= 0) & (own < SURE))
        if len(doubtful):
            before = np.minimum(self._now(self.met, time), lit)
            own[doubtful] = np.maximum(own[doubtful], by_others(found, doubtful, before[doubtful]))
        return np.where(own < SURE, own, 1.0)

    def take(self, found: Finding, given: Floats, lit: Floats, time: float) -> None:
        """Learn from a frame.

        Parameters
        ----------
        found : Finding
        given : (n,) float64 array
            Probability of each match, given the pose.
        lit : (n,) float64 array
            Probability that each point is lit, before the frame was seen.
        time : float
        """
        matched, met = found.assignment >= 0, self._now(self.met, time)
        met = np.where(self.seen < self.time, np.minimum(met, lit), met)
        given = np.minimum(given, self.most(found, lit, time))
        if found.posterior is not None and len(found.posterior.probabilities) > 1:
            other = _in_modes(found.posterior)  # what is one of several poses now, may be the only one in a moment
            possible = ~matched & (other > WRONG_MODEL)
            given = np.where(possible, np.minimum(other, self._now(self.own, time)), given)
            matched = matched | possible
        self.own, self.met = np.where(matched, given, self.own), np.where(matched, met, self.met)
        self.seen, self.time = np.where(matched, time, self.seen), time


def _in_modes(told: Posterior) -> Floats:
    """Probability (n,) that each point has the match that it has in any of the modes."""
    modes = told.modes.take(slice(len(told.probabilities)))
    return np.asarray(told.probabilities @ (modes.local * (modes.assignments >= 0)))


def by_others(found: Finding, doubtful: Integers, before: Floats) -> Floats:
    """Probability (m,) of the doubtful matches by the image alone: the prediction has them in it.

    Summed are all of them, all but one, one beside the sure matches, and these alone.

    Parameters
    ----------
    found : Finding
    doubtful : (m,) int array
        Points.
    before : (m,) float64 array
        Probability of their matches, as far as the image does not tell.
    """
    model, told = found.model, found.posterior
    assert model is not None
    assert told is not None
    right, modes, k = _mostly_right(len(doubtful)), told.modes, slice(found.mode, found.mode + 1)
    assignments = np.tile(found.assignment, (len(right), 1))
    assignments[:, doubtful] = np.where(right, found.assignment[doubtful], -1)
    at = model.linearised(modes.rotation[k], modes.position[k])
    prior = model.prior.without if isinstance(model.prior, Doubted) else model.prior
    weight = evidence(model, assignments, at, prior).log_odds
    weight = weight + np.where(right, log_chance(before), log_chance(1.0 - before)).sum(axis=1)
    weight = np.exp(weight - weight.max())
    return np.asarray(weight @ right / weight.sum())


def _mostly_right(count: int) -> Bools:
    """Which of so many matches are right (K, count): all, none, one, or all but one."""
    one = np.eye(count, dtype=np.bool_)
    each = [np.ones((1, count), np.bool_), np.zeros((1, count), np.bool_), *[one][: count - 1], *[~one][: count - 2]]
    return np.concatenate(each)

"""How probable each of several answers is, and what else is nearly as probable: every answer fitted by one pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.problems.base import Problem
from rootmatch.problems.pose_fit.base import Fit
from rootmatch.samplers.clutter import CROWDING

Integers = NDArray[np.int64]

NEAR = 6.0
"""Logarithm of the odds against an answer at which it is not looked at any more."""
GIVEN = 20.0
"""Degrees of freedom that σ as it is given counts for, where the points themselves say that it is larger."""
FEWER = 2
"""Degrees of freedom by which an answer may have less for that than the first: one point."""
ROUNDS, LOOKED_AT, MOVES = 4, 6, 32
"""Times that the neighbourhoods of answers are searched, answers in each, and changes of one answer that are tried."""


@dataclass(frozen=True)
class Evidence:
    """What is known beside the answers.

    Attributes
    ----------
    problem : Problem
        One that fits answers.
    source, target, noise
        As for `Problem.prepare`.
    allowed : (n, n') bool array, optional
        Correspondences that are possible.
    prior : (n, n') array, optional
        Relative odds of correspondences.
    normals : (n, 3) array, optional
    """

    problem: Problem
    source: NDArray[np.float64]
    target: NDArray[np.float64]
    noise: ArrayLike
    allowed: NDArray[np.bool_] | None = None
    prior: NDArray[np.float64] | None = None
    normals: NDArray[np.float64] | None = None

    def odds(self, answer: Integers) -> NDArray[np.float64]:
        """Logarithm of the prior odds of each match (n, n') against clutter, times pixel².

        A source point is seen as often as those of ``answer`` are; clutter is as dense as what it leaves.
        """
        n, n_target = len(self.source), len(self.target)
        matched = int((answer >= 0).sum())
        area = self._area()
        density = CROWDING * (n_target - matched + 0.5) / area
        seen = (matched + 0.5) / (n + 1.0)
        odds = np.full((n, n_target), np.log(seen / (1.0 - seen)) - np.log(density))
        if self.prior is not None:
            with np.errstate(divide="ignore"):
                odds += np.log(self.prior / max(float(self.prior.max(initial=0.0)), 1e-300))
        if self.allowed is not None:
            odds[~self.allowed] = -np.inf
        return odds

    def against_none(self, answer: Integers) -> float:
        """Logarithm of the odds of an answer's clutter and of what it leaves unseen, against clutter alone."""
        n, n_target, matched = len(self.source), len(self.target), int((answer >= 0).sum())
        seen, left = (matched + 0.5) / (n + 1.0), n_target - matched
        # two Poisson processes, each with the density that it would be given
        clutter = left * np.log((left + 0.5) / self._area()) - n_target * np.log(n_target / self._area())
        return float(matched * np.log(seen) + (n - matched) * np.log(1.0 - seen) + clutter + matched - 0.5)

    def _area(self) -> float:
        """Of the image; the box around n' uniform points is smaller than what they were drawn from."""
        n_target = len(self.target)
        return max(float(np.prod(np.ptp(self.target, axis=0))) * ((n_target + 1) / (n_target - 1)) ** 2, 1e-300)


@dataclass(frozen=True)
class Ranked:
    """Answers, the most probable first.

    Attributes
    ----------
    answers : list of (n,) int64 arrays
    logarithms : (K,) array
        Of their probabilities relative to the first.
    """

    answers: list[Integers]
    logarithms: NDArray[np.float64]
    beyond_chance: float
    """Logarithm of the odds of the first answer against no answer, all detections clutter; NaN where not known."""

    @property
    def probability(self) -> float:
        """Of the first answer, if one of them is right."""
        return self.probability_of(1)

    def probability_of(self, count: int) -> float:
        """That the right answer is among the first ones."""
        shares = np.exp(self.logarithms)
        return float(shares[:count].sum() / shares.sum())


def ranked(evidence: Evidence, answers: list[Integers]) -> Ranked:
    """Answers by their probability, and others near the most probable ones.

    The probability of an answer is that of its detections about its best pose, the pose integrated out, against clutter
    of uniform density. Near ones differ by a point left out, put in or moved to a free detection, or by two exchanged.

    Parameters
    ----------
    evidence : Evidence
    answers : list of (n,) int64 arrays
        The best one first.
    """
    least = evidence.problem.minimal + 1
    odds = evidence.odds(answers[0])
    pool = {answer.tobytes(): answer for answer in answers if (answer >= 0).sum() >= least}
    fits: dict[bytes, tuple[Fit, int]] = {}
    value: dict[bytes, float] = {}
    visited: set[bytes] = set()
    for turn in range(ROUNDS + 1):
        fits |= _fits(evidence, [key for key in pool if key not in fits], pool)
        inflation = _inflation(fits)
        for key, (fit, k) in fits.items():
            matched = np.flatnonzero(pool[key] >= 0)
            total = float(fit.inflated(inflation)[k] + odds[matched, pool[key][matched]].sum())
            value[key] = total if np.isfinite(total) else -np.inf
        if turn == ROUNDS or not value:
            break
        best = max(value.values())
        near = [key for key in sorted(value, key=lambda key: -value[key]) if value[key] > best - NEAR]
        waiting = [key for key in near if key not in visited][:LOOKED_AT]
        if not waiting:
            break
        for key in waiting:
            visited.add(key)
            fit, k = fits[key]
            for other, gain in _neighbours(evidence, odds + fit.densities(k, inflation), pool[key], fit, k):
                if value[key] + gain > best - NEAR and (other >= 0).sum() >= least:
                    pool.setdefault(other.tobytes(), other)
    order = sorted(value, key=lambda key: (-value[key], key))
    order = [key for key in order if value[key] > -np.inf]
    logarithms = np.array([(value[key] - value[order[0]]) / fits[key][0].doubt for key in order])
    if not order:
        return Ranked([], logarithms, np.nan)
    fit, k = fits[order[0]]
    beyond = float(fit.inflated(inflation)[k]) + fit.of_pose() + evidence.against_none(pool[order[0]])
    return Ranked([pool[key] for key in order], logarithms, beyond)


def _fits(evidence: Evidence, keys: list[bytes], pool: dict[bytes, Integers]) -> dict[bytes, tuple[Fit, int]]:
    """The fits of some answers of the pool, and their places in them."""
    if not keys:
        return {}
    answers = np.array([pool[key] for key in keys])
    fit = evidence.problem.fitted(evidence.source, evidence.target, evidence.noise, answers)
    return {key: (fit, k) for k, key in enumerate(keys)}


def _inflation(fits: dict[bytes, tuple[Fit, int]]) -> float:
    """Factor by which the variances are larger than given, by the best of some answers; 1 at the least.

    Only those count that match hardly fewer points than the first one: the fewer, the better they fit.
    """
    found = [(float(fit.chi2[k]), int(fit.freedom[k])) for fit, k in fits.values()]
    fair = [(GIVEN + chi2) / (GIVEN + freedom) for chi2, freedom in found if freedom >= found[0][1] - FEWER]
    return max(1.0, min(fair, default=1.0)) if np.isfinite(min(fair, default=1.0)) else 1.0


def _neighbours(
    evidence: Evidence, gain: NDArray[np.float64], answer: Integers, fit: Fit, k: int
) -> list[tuple[Integers, float]]:
    """The most probable changes of an answer, and the logarithms of their odds against it to first order.

    ``gain`` (n, n') holds the logarithm of the odds of each match against none, as the others have it.
    """
    n = len(answer)
    every, matched = np.arange(n), answer >= 0
    if evidence.normals is not None:
        gain[~matched & fit.unseen(k, evidence.normals)] = -np.inf
    own = np.where(matched, gain[every, np.maximum(answer, 0)], 0.0)
    own = np.where(np.isfinite(own), own, -1e9)
    free = np.ones(gain.shape[1], np.bool_)
    free[answer[matched]] = False
    to_free = np.where(free, gain - own[:, None], -np.inf)
    left_out = np.where(matched, -own, -np.inf)
    # theirs[i, j]: point i at the detection of j, which takes that of i, or none where i has none
    theirs = np.where(matched, gain[:, answer], -np.inf)
    back = np.where(matched[:, None], theirs.T, 0.0)
    pairs = matched[None, :] & (~matched[:, None] | (every[:, None] < every))
    exchanged = np.where(pairs, theirs + back - own[:, None] - own, -np.inf)
    changes = np.concatenate([to_free.ravel(), left_out, exchanged.ravel()])
    chosen = np.flatnonzero(changes > -2.0 * NEAR)
    chosen = chosen[np.argsort(-changes[chosen], kind="stable")[:MOVES]]
    out = []
    for place in chosen.tolist():
        other = answer.copy()
        if place < to_free.size:
            other[place // free.size] = place % free.size
        elif place < to_free.size + n:
            other[place - to_free.size] = -1
        else:
            i, j = divmod(place - to_free.size - n, n)
            other[i], other[j] = answer[j], answer[i]
        out.append((other, float(changes[place])))
    return out

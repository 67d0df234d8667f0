"""Several motions in two views: poses are sampled together, and at each set of poses all assignments are summed.

With the share ρ_m of the points that are of motion m and detected, and ρ_0 of those that are not, a pair has the odds
Σ_m ρ_m p_ij(T_m) / (ρ_0 Λ f_j) against being unmatched, so that the sum over assignments is that of one motion
(`rootmatch.model.two_view_posterior`), and which motion a point is of is summed with them. Shares have a flat prior.

Poses are drawn from the posterior of each motion among the points and detections that the others leave, shares and Λ
about their expected numbers. The weights are by the density of that, so what one motion took from another comes back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.model.matchings import Matchings, sum_matchings_by_part
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.model.two_view_alike import FEWEST_SAMPLES
from rootmatch.model.two_view_model import TwoViewModel
from rootmatch.model.two_view_posterior import FIRST, MARGIN, MAX_RATIOS, MINIMUM, TwoViewPosterior, possible_pairs
from rootmatch.model.two_view_samples import Samples

SAMPLES = 256
"""Sets of poses. A round value."""


class Motion(NamedTuple):
    """One of several motions."""

    told: TwoViewPosterior
    """Among what the others leave."""
    points: Integers
    """Points that those are."""
    detections: Integers

    @property
    def matches(self) -> float:
        """Expected number of its matches."""
        return float(self.told.marginals.sum())


@dataclass(frozen=True, eq=False)
class MotionsPosterior(TwoViewPosterior):
    """The posterior of several motions in two views.

    Attributes
    ----------
    motions : sequence of TwoViewPosterior
        Of each motion given all others, as far as its presence goes.
    drawn : sequence of Samples
        The samples of each motion, those of all parts in turn, with the odds ρ_m / (1 + ρ_m) in the place of δ.
    """

    motions: Sequence[TwoViewPosterior] = ()
    drawn: Sequence[Samples] = ()

    @property
    def presences(self) -> list[float]:
        """Probability that the images show each of the motions."""
        return [one.present for one in self.motions]

    @property
    def present(self) -> float:
        """Probability that the images show all of the motions."""
        return float(np.prod(self.presences))

    @cached_property
    def unmatched(self) -> Floats:
        """Probability (n,) that each point has no match."""
        absent = 1.0 - WRONG_MODEL - self.present
        return np.asarray(absent + self.present * np.maximum(1.0 - self._matched, 0.0))

    def label_motions(self, assignment: Integers) -> Integers:
        """The motion (n,) that each match of an assignment is most probably of; −1 for unmatched points."""
        own = np.flatnonzero(assignment >= 0)
        weights = np.concatenate([weights for _, weights, _ in self.parts])
        pairs = own, assignment[own]
        odds = np.exp(np.minimum([one.log_odds(self.model, pairs) for one in self.drawn], 300.0))
        shares = np.tensordot(odds / (1.0 + odds.sum(axis=0)), weights, axes=(1, 0))
        labels = np.full(len(assignment), -1, np.int64)
        labels[own] = shares.argmax(axis=0)
        return labels

    def chi2_and_dof(self, assignment: Integers) -> tuple[float, int]:
        """See `TwoViewPosterior.sum_of_squares`: the sum over motions, each with the matches that are its own."""
        labels = self.label_motions(assignment)
        every = [
            TwoViewPosterior.chi2_and_dof(
                replace(self, parts=[(one, *self.parts[0][1:])]), np.where(labels == m, assignment, -1)
            )
            for m, one in enumerate(self.drawn)
        ]
        return sum(chi2 for chi2, _ in every), sum(freedom for _, freedom in every)


def motions_posterior(model: TwoViewModel, motions: Sequence[Motion], seed: int = 0) -> MotionsPosterior:
    """The posterior of several motions, by that of each.

    ``model``: of all points and detections. Each of the motions has matches.
    """
    rng = np.random.default_rng([seed, 19])
    every = [_draw_motion_samples(one, rng) for one in motions]
    alone = sum(one.told.log_evidence for one in motions)
    whole, log, parts = _weigh_motion_samples(model, motions, every, rng)
    each = []
    for m, one in enumerate(motions):
        left = [k for k in range(len(motions)) if k != m]
        without = _weigh_motion_samples(model, [motions[k] for k in left], [every[k] for k in left], rng)[1]
        gained = one.told.log_evidence + _log_mean(log) - _log_mean(without)
        each.append(replace(one.told, log_evidence=gained))
    total = float(np.logaddexp.reduce(log))
    order = np.concatenate([rows for rows, _ in parts])
    return MotionsPosterior(
        replace(model, weighs_parts=False),
        alone + _log_mean(log),
        [(whole[0].take(rows), np.exp(log[rows] - total), sums) for rows, sums in parts],
        motions=each,
        drawn=[one.take(order) for one in whole],
    )


class _Drawn(NamedTuple):
    """Samples of one motion by its own posterior."""

    samples: Samples
    part: Integers
    """(S,) number of the part that each is of."""
    log_own: Floats
    """(S,) logarithms of what its posterior tells, over the density of rate and clutter given the poses."""


def _draw_motion_samples(motion: Motion, rng: np.random.Generator) -> _Drawn:
    """Samples of a motion."""
    from scipy.special import gammaln  # slow to import

    told = motion.told
    part = np.concatenate([np.full(len(weights), k) for k, (_, weights, _) in enumerate(told.parts)])
    edges = np.cumsum(np.concatenate([weights for _, weights, _ in told.parts]))
    chosen = np.searchsorted(edges / edges[-1], (np.arange(SAMPLES) + rng.random()) / SAMPLES).clip(max=len(part) - 1)
    chosen = rng.permutation(chosen)
    samples = Samples.joined([drawn for drawn, _, _ in told.parts])
    log_total = np.concatenate([sums.log_total for _, _, sums in told.parts])[chosen]
    samples, (n, n_target), k = samples.take(chosen), told.model.shape, motion.matches
    log, clutter = log_total + n * np.log1p(-samples.rate) - float(gammaln(n_target + 0.5)), samples.clutter
    log += (n_target - 0.5) * np.log(clutter) - clutter - _log_gamma(clutter, n_target - k + 0.5)
    if told.model.detection_rate is None:
        log -= _log_dirichlet(np.stack([samples.rate, 1.0 - samples.rate]), np.array([k, n - k]) + 1.0)
    return _Drawn(samples, part[chosen], log)


def _weigh_motion_samples(
    model: TwoViewModel, motions: Sequence[Motion], every: Sequence[_Drawn], rng: np.random.Generator
) -> tuple[list[Samples], Floats, list[tuple[Integers, Matchings]]]:
    """Samples of all motions with their shares, logarithms (S,) of their weights, and sums over assignments.

    Those are of samples (rows) whose motions are about the same poses.
    """
    from scipy.special import gammaln  # slow to import

    checkpoint()
    (n, n_target), log = model.shape, np.zeros(SAMPLES)
    if not motions:
        return [], log, []
    matches = np.array([one.matches for one in motions])
    left = max(n_target - float(matches.sum()), 0.0) + 0.5
    clutter = rng.gamma(left, size=SAMPLES)
    known = model.detection_rate
    numbers = matches + 1.0
    if known is None:
        numbers = np.append(numbers, max(n - float(matches.sum()), 0.0) + 1.0)
    shares = rng.dirichlet(numbers, SAMPLES).T
    log += float(gammaln(len(numbers))) - _log_dirichlet(shares, numbers) - _log_gamma(clutter, left)
    if known is not None:
        shares = np.concatenate([known * shares, np.full((1, SAMPLES), 1.0 - known)])
    log += n * np.log(shares[-1]) + (n_target - 0.5) * np.log(clutter) - clutter - float(gammaln(n_target + 0.5))
    rates = shares[:-1] / (shares[:-1] + shares[-1])
    whole = [one.samples._replace(rate=rate, clutter=clutter) for one, rate in zip(every, rates, strict=True)]
    rows, columns = pairs = possible_pairs(model)
    first = np.arange(max(min(FIRST, MAX_RATIOS // max(len(rows), 1)), FEWEST_SAMPLES))
    likely = np.max([one.take(first).log_odds(model, pairs).max(axis=0) for one in whole], axis=0) > MINIMUM - MARGIN
    pairs = rows[likely], columns[likely]
    odds = np.logaddexp.reduce([one.log_odds(model, pairs) for one in whole])
    log -= sum(one.log_own for one in every)
    places = np.unique(np.stack([one.part for one in every]), axis=1, return_inverse=True)[1].ravel()
    parts = []
    for place in np.unique(places).tolist():
        own = np.flatnonzero(places == place)
        parts.append((own, sum_matchings_by_part(odds[own], *pairs, MINIMUM)))
        log[own] += parts[-1][1].log_total
    return whole, log, parts


def _log_mean(log: Floats) -> float:
    """Logarithm of the mean of values by their logarithms."""
    return float(np.logaddexp.reduce(log)) - float(np.log(len(log)))


def _log_gamma(values: Floats, shape: float) -> Floats:
    """Logarithm of the density of a gamma distribution."""
    from scipy.special import gammaln  # slow to import

    return np.asarray((shape - 1.0) * np.log(values) - values - gammaln(shape))


def _log_dirichlet(shares: Floats, numbers: Floats) -> Floats:
    """Logarithm (S,) of the density of a Dirichlet distribution at shares (C, S)."""
    from scipy.special import gammaln  # slow to import

    return np.asarray((numbers - 1.0) @ np.log(shares) + gammaln(numbers.sum()) - gammaln(numbers).sum())

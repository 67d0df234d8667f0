"""The posterior of the matches of two images: poses are sampled, and at each pose all assignments are summed.

Given a pose, the number of clutter points Λ and the detection rate δ, the pairs are independent but for their being one
to one, and the sum over all assignments is exact (`rootmatch.model.matchings`):

    p(y | T, δ, Λ) = e^(−Λ) Λ^n' (1 − δ)ⁿ Σ_o Π_(i,j in o) [δ / (1 − δ)] w_ij p_ij(T) / (Λ f_j) · Π_j f_j

The integral over T, s², δ and Λ is a mean over samples about the poses of proposed assignments (importance sampling
from a mixture of Student's t distributions, its weights by the density of the whole mixture). Nothing is of first
order, and no assignment is preferred because it was proposed. What no proposal is near is missed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.hypergraph.assignment import maximise_total
from rootmatch.model.matchings import FEWEST, Matchings, log_sum_of_enough, sum_matchings
from rootmatch.model.priors import WRONG_MODEL, beta_quadrature
from rootmatch.model.shown_in_part import odds_of_few
from rootmatch.model.two_view_alike import FEWEST_SAMPLES, likeness_log_odds
from rootmatch.model.two_view_fit import Fitted, drop_similar, fit_relative_poses
from rootmatch.model.two_view_model import Relative, TwoViewModel
from rootmatch.model.two_view_samples import (
    Samples,
    choose_centres,
    draw_samples,
    log_proposal_density,
    log_sample_prior,
    recentre_on_samples,
)

MISSED = 0.1
"""Probability that a search proposes no pose near the right one. It bounds how sure it is that the images have
nothing in common: what was missed may explain them. A stated value, not measured."""
FIRST = 128
"""First samples, which tell where to draw. A round value."""
MAX_RATIOS = 4_000_000
"""Pairs of points times first samples: 32 MB."""
NAMED = 12
"""First of the assignments that were named which are fitted: as many as a search names."""
RELABELLED = 2
"""Times that the likeliest labellings at fits are fitted in turn. A round value; what it gains is in the notebook."""
SAMPLES = 768
"""Samples that count. A round value; what the mean leaves open is measured in docs/two-view-model.md."""
MINIMUM = math.log(1e-3)
"""Log-odds of a pair below which it counts for nothing. A round value."""
MARGIN = 3.0
"""Log-odds below that from which a pair of the first samples is looked at in the second ones. A round value."""
NEGLIGIBLE = 12.0
"""Log evidence below the best at which samples count for nothing. A round value."""
ROUNDS = 3
"""Most times that samples are drawn about those before. A round value."""
ENOUGH = 40.0
"""Effective number of samples (Kish) with which that ends. A round value."""
SECONDS_PER_PAIR = 1e-9
"""To list a pair of a point and a detection (benchmarks/deadlines.py, task 160)."""
LOOKED_AT = 6
"""Samples whose likeliest assignments are proposed. A round value."""


@dataclass(frozen=True, eq=False)
class TwoViewPosterior:
    """Samples of the pose with all their assignments, and what follows from them.

    Attributes
    ----------
    model : TwoViewModel
    log_evidence : float
        Logarithm of the odds that the images show the same points, in a pose near those proposed, against clutter
        alone, by the images.
    parts : list of (Samples, weights, Matchings)
        K samples about each pose, their weights (K,), which sum to one over all parts, and their sums over assignments.
    likeness : two floats
        Logarithms of the odds that the scenes are alike and not the same, and of what a scene like itself adds to the
        odds of the same points: as of `rootmatch.model.two_view_alike.likeness_log_odds`.
    """

    model: TwoViewModel
    log_evidence: float
    parts: list[tuple[Samples, Floats, Matchings]]
    likeness: tuple[float, float] = -math.inf, 0.0

    @property
    def present(self) -> float:
        """Probability that the images show the same points, in a pose near those proposed."""
        present = self.model.present
        found = self.log_evidence + self.likeness[1] + math.log(present * (1.0 - MISSED))
        alike = self.likeness[0] + math.log(1.0 - present)
        rest = float(np.logaddexp(math.log(1.0 - present * (1.0 - MISSED)), alike))
        return (1.0 - WRONG_MODEL) / (1.0 + math.exp(min(rest - found, 700.0)))

    @property
    def presences(self) -> list[float]:
        """Presence of each motion, of which this has one."""
        return [self.present]

    def label_motions(self, assignment: Integers) -> Integers:
        """The motion (n,) of each match of an assignment; −1 for unmatched points."""
        return np.where(assignment >= 0, 0, -1)

    @cached_property
    def marginals(self) -> Floats:
        """Probability (n, n') of each pair if the images show the same points."""
        marginals = np.zeros(self.model.shape)
        for _, weights, sums in self.parts:
            np.add.at(marginals, (sums.rows, sums.columns), weights @ sums.marginals)
        return marginals

    @cached_property
    def _matched(self) -> Floats:
        """Probability (n,) that each point has a match if the images show the same points."""
        # without samples the table of thousands of points would take as long as a short time limit
        return np.asarray(self.marginals.sum(axis=1)) if self.parts else np.zeros(self.model.shape[0])

    @cached_property
    def unmatched(self) -> Floats:
        """Probability (n,) that each point has no match."""
        odds, few = self._partial_view_odds
        missed = MISSED * max(1.0 - odds, 0.0)  # of what shows enough
        present = self.model.present
        unlike = (1.0 - present) * (1.0 + math.exp(min(self.likeness[0], 700.0)))
        without = (unlike + present * odds * few) / (unlike + present * (odds + missed))
        absent = (1.0 - WRONG_MODEL - self.present) * without
        return np.asarray(absent + self.present * np.maximum(1.0 - self._matched, 0.0))

    @property
    def _partial_view_odds(self) -> tuple[float, Floats]:
        """Odds, against clutter, of a motion of fewer matches than are proposed; how often each point (n,) has none."""
        (n, n_target), rate = self.model.shape, self.model.detection_rate
        if not self.model.weighs_parts:
            return 0.0, np.ones(n)
        rates, log_weights = beta_quadrature(1.0, 1.0) if rate is None else (np.array([rate]), np.zeros(1))
        chance = np.tile(rates, (1, n, 1))
        return odds_of_few(chance, np.exp(log_weights), np.array([n_target]), self.model.size - 2)

    def confidence_in(self, assignment: Integers) -> Floats:
        """Probability (n,) that each point's match, or its being unmatched, is right."""
        if not (assignment >= 0).any():
            return self.unmatched
        own = self.marginals[np.arange(len(assignment)), np.maximum(assignment, 0)]
        return np.where(assignment >= 0, self.present * own, self.unmatched)

    @cached_property
    def likeliest_pairs(self) -> Integers:
        """The assignment (n,) with the most matches that are expected to be right."""
        # a pair that is less probable than that its point has no match is none
        return maximise_total(self.marginals, 1.0 - self._matched)

    @cached_property
    def proposals(self) -> Integers:
        """Assignments (A, n) that are the likeliest at some samples of each pose, the most probable one first."""
        every = [self.likeliest_pairs] if self.parts else []
        for _, weights, sums in self.parts:
            for k in np.argsort(-weights, kind="stable")[:LOOKED_AT]:
                every.append(_likeliest_assignment(sums.log_odds[k], sums.rows, sums.columns, self.model))
        unlike = np.unique(np.array(every, np.int64).reshape(len(every), self.model.shape[0]), axis=0)
        return np.asarray(unlike[np.argsort([-self.share(one) for one in unlike], kind="stable")])

    @cached_property
    def shares(self) -> list[float]:
        """Of the proposals."""
        return [self.share(one) for one in self.proposals]

    def share(self, assignment: Integers) -> float:
        """Probability of an assignment (n,) if the images show the same points."""
        total, count = 0.0, np.count_nonzero(assignment >= 0)
        if count < FEWEST:
            return 0.0
        for _, weights, sums in self.parts:
            own = assignment[sums.rows] == sums.columns
            if np.count_nonzero(own) == count:
                total += float(weights @ np.exp(sums.log_odds[:, own].sum(axis=1) - sums.log_total))
        return total

    def assignment_probability(self, assignment: Integers) -> float:
        """Probability of an assignment (n,), which is never above that of one of its matches."""
        return self.present * self.share(assignment)

    def assignment_log_odds(self, assignment: Integers) -> float:
        """Logarithm of the odds of an assignment (n,) against clutter alone, by the images."""
        return self.log_evidence + math.log(max(self.share(assignment), 1e-300))

    def together(self, assignment: Integers, some: Integers) -> float:
        """Probability that some matches of an assignment (n,) are all right: of one pose, they are independent."""
        total = 0.0
        for _, weights, sums in self.parts:
            own = np.isin(sums.rows, some) & (assignment[sums.rows] == sums.columns)
            if np.count_nonzero(own) == len(some):
                total += float(weights @ np.prod(sums.marginals[:, own], axis=1))
        return self.present * total

    def chi2_and_dof(self, assignment: Integers) -> tuple[float, int]:
        """Squared deviations of an assignment from the epipolar planes, and their degrees of freedom.

        At the sample that they fit best.
        """
        own = np.flatnonzero(assignment >= 0)
        poses = Relative.joined([drawn.poses for drawn, _, _ in self.parts])
        e = self.model.seen(poses, own, assignment[own]).e
        lost = (2 if self.model.planar else 3) + (2 if self.model.tilt > 0.0 else 0)
        return float((e * e).sum(axis=1).min()), max(len(own) - lost, 0)


def sample_two_view_posterior(
    model: TwoViewModel, assignments: Integers, seed: int = 0, alike: bool = True
) -> TwoViewPosterior:
    """The posterior about the poses of proposed assignments (K, n); ``alike``: whether scenes may be alike."""
    rng = np.random.default_rng([seed, 17])
    assignments = assignments[(assignments >= 0).sum(axis=1) >= model.size - 1]
    if not len(assignments):
        return TwoViewPosterior(model, -math.inf, [])
    checkpoint(SECONDS_PER_PAIR * model.shape[0] * model.shape[1])
    rows, columns = possible = possible_pairs(model)
    centres = choose_centres(model, _fit_and_relabel(model, assignments[:NAMED]))
    checkpoint()
    drawn = draw_samples(model, centres, max(min(FIRST, MAX_RATIOS // len(rows)), FEWEST_SAMPLES), rng)
    odds, base = _sample_log_odds(model, drawn, rows, columns)
    bound = base - log_proposal_density(model, centres, drawn) + _log_sum_bound(odds, rows)
    # the likeliest assignments of the first samples may have another pose
    best = np.argsort(-bound, kind="stable")[:LOOKED_AT]
    likely = drop_similar(
        np.array([*centres.fits.assignments, *(_likeliest_assignment(odds[k], rows, columns, model) for k in best)])
    )
    likely = likely[len(drop_similar(centres.fits.assignments)) :]
    likely = likely[(likely >= 0).sum(axis=1) >= model.size - 1]
    checkpoint()
    if len(likely):
        centres = choose_centres(model, centres.fits.joined(fit_relative_poses(model, likely)))
    fits = centres
    for _ in range(ROUNDS):
        if not np.isfinite(bound.max(initial=-np.inf)):
            return TwoViewPosterior(model, -math.inf, [])
        some = odds[bound > bound.max() - NEGLIGIBLE].max(axis=0) > MINIMUM - MARGIN
        rows, columns = rows[some], columns[some]
        centres = recentre_on_samples(model, fits, drawn, np.exp(bound - bound.max()))
        drawn = draw_samples(model, centres, SAMPLES, rng)
        odds, base = _sample_log_odds(model, drawn, rows, columns)
        base -= log_proposal_density(model, centres, drawn)
        bound = base + _log_sum_bound(odds, rows)
        checkpoint()
        if not np.isfinite(bound.max()):
            return TwoViewPosterior(model, -math.inf, [])
        weights = np.exp(bound - bound.max())
        if weights.sum() ** 2 >= ENOUGH * (weights**2).sum():
            break
    group = centres.group[drawn.centre]
    groups = sorted(set(group.tolist()), key=lambda g: -float(bound[group == g].max()))
    found, values, every = -math.inf, [], []
    for g in groups:
        own = np.flatnonzero((group == g) & (bound > max(found, float(bound[group == g].max())) - NEGLIGIBLE))
        if not len(own):
            continue
        order = _sort_about_baseline(model, drawn.poses.take(own[bound[own].argmax()][None]))
        sums = sum_matchings(odds[own], rows, columns, order, MINIMUM)
        known = np.flatnonzero(np.isfinite(sums.log_total))
        if not len(known):
            continue
        own, sums = own[known], sums.take(known)
        values.append(base[own] + sums.log_total)
        every.append((drawn.take(own), sums))
        found = max(found, float(values[-1].max()))
    if not values:
        return TwoViewPosterior(model, -math.inf, [])
    total = float(np.logaddexp.reduce(np.concatenate(values)))
    parts = [(some, np.exp(value - total), sums) for value, (some, sums) in zip(values, every, strict=True)]
    told = TwoViewPosterior(model, total - math.log(SAMPLES), parts)
    return replace(told, likeness=likeness_log_odds(told, fits, possible, seed)) if alike else told


def likeliest_labellings(model: TwoViewModel, fits: Fitted) -> Integers:
    """Assignments (K, n) that are the likeliest at K fits, whatever those are of."""
    rows, columns = possible_pairs(model)
    matched = (fits.assignments >= 0).sum(axis=1)
    rate, clutter = (matched + 0.5) / (model.shape[0] + 1.0), model.shape[1] - matched + 0.5
    at = Samples(fits.poses, np.ones(len(rate)), rate, clutter, np.arange(len(rate)))
    odds = at.log_odds(model, (rows, columns))
    return np.array([_likeliest_assignment(one, rows, columns, model) for one in odds])


def _fit_and_relabel(model: TwoViewModel, assignments: Integers) -> Fitted:
    """Fits of assignments (K, n), and of those that are the likeliest at them.

    A search that takes an uncertain common direction for noise names pairs far off the pose that the others tell.
    """
    every = fits = fit_relative_poses(model, assignments)
    for _ in range(RELABELLED):
        likely = np.unique(likeliest_labellings(model, fits), axis=0)
        if not len(likely := likely[(likely >= 0).sum(axis=1) >= model.size - 1]):
            break
        fits = fit_relative_poses(model, likely)
        every = every.joined(fits)
    return every


def possible_pairs(model: TwoViewModel) -> tuple[Integers, Integers]:
    """Points and detections (P,) of the pairs that may be matches."""
    if model.log_weights is None:
        n, n_target = model.shape
        return np.repeat(np.arange(n), n_target), np.tile(np.arange(n_target), n)
    every = np.flatnonzero(np.isfinite(model.log_weights))
    return every // model.shape[1], every % model.shape[1]


def _sample_log_odds(model: TwoViewModel, drawn: Samples, rows: Integers, columns: Integers) -> tuple[Floats, Floats]:
    """Log-odds (K, P) of pairs against being unmatched, and the logarithm (K,) of all else but the density of drawing.

    That is the prior, and the probability that no point is detected, against clutter whatever its number.
    """
    from scipy.special import gammaln  # slow to import

    n, n_target = model.shape
    odds = drawn.log_odds(model, (rows, columns))
    log = n_target * np.log(drawn.clutter) - drawn.clutter - float(gammaln(n_target + 0.5))
    return odds, log + n * np.log1p(-drawn.rate) + log_sample_prior(model, drawn)


def _log_sum_bound(odds: Floats, rows: Integers) -> Floats:
    """Logarithm (K,) of the sum over assignments if a detection could have many points: no sum is larger."""
    if not len(rows):
        return np.full(len(odds), -np.inf)
    first = np.flatnonzero(np.diff(rows, prepend=-1))  # rows are in order
    of_rows = np.add.reduceat(np.exp(np.minimum(odds, 300.0)), first, axis=1)
    with np.errstate(divide="ignore"):
        return log_sum_of_enough(np.log1p(of_rows).sum(axis=1), np.log(of_rows), np.arange(len(first)), None)


def _sort_about_baseline(model: TwoViewModel, pose: Relative) -> Integers:
    """The points (n,) in the order of their epipolar planes about the baseline."""
    u = (model.first @ pose.rotation.swapaxes(-1, -2))[0]
    first, second = np.linalg.svd(pose.translation[0][None])[2][1:]
    angle = np.arctan2(u @ first, u @ second) % (2.0 * math.pi)
    order = np.argsort(angle, kind="stable")
    # from the widest gap on
    gaps = np.diff(np.append(angle[order], angle[order[0]] + 2.0 * math.pi))
    return np.roll(order, -1 - int(gaps.argmax()))


def _likeliest_assignment(odds: Floats, rows: Integers, columns: Integers, model: TwoViewModel) -> Integers:
    """The assignment (n,) with the largest odds, by log-odds (P,) of pairs."""
    gain = np.zeros(model.shape)
    gain[rows, columns] = np.maximum(odds, 0.0)
    return maximise_total(gain, 0.0)

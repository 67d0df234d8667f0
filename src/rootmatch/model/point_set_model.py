"""The model of two point sets of one space: log-odds of a labelling against clutter alone, the motion integrated out.

A source point is detected with the rate δ, at its place after the motion x' = s R x + t, with the noise of both points;
the other targets are a Poisson process of density λ f(y), see `rootmatch.model.clutter.Clutter`, in the volume V that
the targets span. Against the hypothesis that all targets are clutter, a labelling of m of n points by n' targets has
the odds

    ∫ δ^m (1 − δ)^(n − m) dδ · Γ(n' − m + ½) / Γ(n' + ½)
        · ∫ ∏ N(x'_j; s R x_i + t, s² σ_i² + σ_j²) / f(x'_j) dT / (V vol)

- δ is given, or integrated under a flat prior: every m is as probable, and each subset; see `shown_regions`.
- λ is integrated under Jeffreys' prior λ^(−½): the second factor, about 1/n'^m.
- f is uniform, or crowds about other targets, as markers of another object do: these are no evidence for this one; and
  about points of the object that are hidden, as their reflections do, with the same shares and widths.
- dT / (V vol) is the prior of the motion: every rotation, a translation that puts the object into V, and a scale that
  is flat in its logarithm (`rootmatch.problems.pose_fit.point_set_fit.DECADES`). It accounts for how vaguely a
  labelling determines the motion and for how many motions could fit by chance; the second factor accounts for the
  number of labellings. Some of it puts the middle of the object anywhere into V, some the whole object, whose
  translation is then the better known the more of V it fills, and some any part of it, so that V is a window through
  which the object is seen: points beyond it are not missed (`PointSetModel.log_factors`).
- Where something is known of the motion, its prior takes the place of that volume (`rootmatch.model.motion_prior`).
- σ is that given times a factor, whose square has an inverse gamma prior of `NOISE_FREEDOM` degrees of freedom about 1:
  exp(−χ²/2) becomes a power of 1 + χ²/ν, as of Student's t.

Two parts are approximated: rotations in space, by Laplace's method with exact curvature, and the factor of σ, outside
of it. Translations and rotations of a plane are exact. Where axes differ in noise, σ² are the covariances of each pair,
and all of the motion is integrated by Laplace's method.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.clutter import Clutter
from rootmatch.model.detection_model import log_count_odds
from rootmatch.model.modes import used_mask
from rootmatch.model.motion_prior import MotionPrior
from rootmatch.model.priors import NOISE_FREEDOM, PRESENT
from rootmatch.model.shown_regions import log_detection_count, log_region_factor
from rootmatch.model.targets_box import (
    UNTOLD,
    WEIGHTS,
    Placement,
    box_edges,
    fit_clutter_space,
    view_probability,
    view_probability_among,
)
from rootmatch.problems.points import PointClouds, pairwise_squared_distances
from rootmatch.problems.pose_fit.point_set_fit import RANGE_OF_LOG, PointSetFit, fit_point_sets
from rootmatch.samplers.point_sets.congruent import GATE


class Judged(NamedTuple):
    """K labellings with their motions and what speaks for each."""

    fit: PointSetFit
    log_odds: Floats
    """(K,) of each against the hypothesis that all targets are clutter."""
    known: Floats
    """(K,): by how much what is known of the motion makes each more probable than it is without; 0 if nothing is."""
    held: Integers
    """The prediction (K,) by which each is most probable; −1 if by none."""

    def take(self, which: Integers | slice) -> Judged:
        """Some of them."""
        return Judged(self.fit.take(which), self.log_odds[which], self.known[which], self.held[which])

    def joined(self, other: Judged) -> Judged:
        """These, followed by others."""
        both = (np.concatenate(pair) for pair in zip(self[1:], other[1:], strict=True))
        return Judged._make([self.fit.joined(other.fit), *both])


@dataclass(frozen=True, eq=False)
class PointSetModel:
    """Two point sets and what is known about them.

    Attributes
    ----------
    clouds : PointClouds
    mirror : bool
        Whether the motion may be a reflection.
    allowed : (n, n') bool array, optional
        Possible correspondences.
    log_weights : (n, n') array, optional
        Logarithms of the prior probabilities of the correspondences, up to a constant.
    detection_rate : float, optional
        Probability that a point of the source is among the targets; unknown by default.
    prior : MotionPrior, optional
        What is known of the motion.
    present : float
        Probability that the targets show the source, before they are seen.
    repeated : Clutter, optional
        Clutter with a repetition in it, see `rootmatch.model.repetition`.
    log_unnamed : float
        Logarithm by which that is less probable where nothing of the source is among the targets, which names it.
    """

    clouds: PointClouds
    mirror: bool = False
    allowed: Bools | None = None
    log_weights: Floats | None = None
    detection_rate: float | None = None
    prior: MotionPrior | None = None
    present: float = PRESENT
    repeated: Clutter | None = None
    log_unnamed: float = 0.0
    _kept: dict[bytes, Judged] = field(default_factory=dict, init=False, repr=False)

    @property
    def log_absent(self) -> float:
        """Logarithm of the odds of clutter alone, before targets are seen."""
        return math.log(1.0 / self.present - 1.0) - self.log_unnamed

    @property
    def log_volume(self) -> float:
        """Logarithm of the volume in which clutter lies, and the object."""
        return float(np.log(self._clutter_space[0]).sum())

    @property
    def box(self) -> Floats:
        """Edges of that volume as columns (k, k)."""
        return np.asarray(self._clutter_space[3] * self._clutter_space[0])

    @property
    def clutter(self) -> Clutter:
        """Where clutter lies."""
        return self._clutter_space[1]

    @cached_property
    def twins(self) -> Bools:
        """Which targets (n', n') may be measurements of one place."""
        target, variance = self.clouds.target, self.clouds.target_variance
        squared = pairwise_squared_distances(target[None], target)[0]
        return np.asarray(squared <= GATE**2 * (variance[:, None] + variance))

    @cached_property
    def _clutter_space(self) -> tuple[Floats, Clutter, Floats, Floats]:
        clouds = self.clouds
        space = fit_clutter_space(clouds.target, clouds.target_variance)
        return space if self.repeated is None else (space[0], self.repeated, *space[2:])

    def fit(self, assignments: Integers) -> PointSetFit:
        """The motion of each assignment (K, n)."""
        return fit_point_sets(self.clouds, assignments, self.mirror)

    def judge(self, assignments: Integers, fit: PointSetFit | None = None, factors: Floats | None = None) -> Judged:
        """Each assignment (K, n) with its motion and log-odds; what `fit` and `log_factors` say, unless it is given."""
        fit = self.fit(assignments) if fit is None else fit
        factors = self.log_factors(fit) if factors is None else factors
        predicted, total = len(factors) - 1, np.asarray(np.logaddexp.reduce(factors, axis=0))
        held = np.where((first := factors.argmax(axis=0)) < predicted, first, -1)
        known = np.zeros(len(total)) if self.prior is None else total - factors[-1] + np.log(self.prior.doubt)
        matched, taken = (assignments >= 0).sum(axis=1), used_mask(fit.assignments, len(self.clouds.target))
        # what was matched, as clutter that may crowd about points of which nothing was detected
        log_clutter = self.clutter.log_density_of_taken(taken, self.clutter_about_points(fit, fit.assignments < 0))
        odds = self.log_density(fit) - self.log_volume + self.log_counts[matched] - log_clutter
        if self.log_weights is not None:
            each = self.log_weights[np.arange(assignments.shape[1]), assignments]
            odds = odds + np.where(assignments >= 0, each, 0.0).sum(axis=1)
        return Judged(fit, np.asarray(odds + self._log_odds_of_lacking(fit, taken) + total), known, held)

    def judge_one(self, assignment: Integers) -> Judged:
        """The same of one assignment (n,), for which several stages ask."""
        key = assignment.tobytes()
        if key not in self._kept:
            self._kept[key] = self.judge(assignment[None])
        return self._kept[key]

    def keep(self, first: Judged) -> None:
        """Remember one labelling for `judge_one`."""
        self._kept[first.fit.assignments[0].tobytes()] = first

    def _log_odds_of_lacking(self, fit: PointSetFit, taken: Bools) -> Floats:
        """Logarithm (K,) of the odds that the source lacks so many of what repeats itself where it shows its points.

        Any share of it may be detected in the source, as in the targets, and each choice of as many is as probable. As
        there, a place beyond the points is in view with a probability.
        """
        if self.clutter.repeating is None:
            return np.zeros(len(fit.scale))
        from scipy.special import betaln  # slow to import

        clouds = self.clouds
        back = (clouds.target - fit.shift[:, None]) @ fit.rotation / fit.scale[:, None, None]
        noise = clouds.source_variance + clouds.target_variance.max() / float(fit.scale[0]) ** 2
        seen = view_probability_among(back, clouds.source, noise)
        lacked, matched = (np.where(taken, 0.0, self.clutter.repeating) * seen).sum(axis=1), taken.sum(axis=1)
        return np.asarray(betaln(matched + 1.0, lacked + 1.0) + np.log(matched + 1.0))

    def log_hidden_clutter(self, matched: Floats | Integers | float) -> Floats:
        """Logarithm by which the targets left are too few for crowds about hidden points, by the number of matches."""
        n, n_target = len(self.clouds.source), len(self.clouds.target)
        about = self.clutter.crowd_share * self._reflection_rate(matched) * (n - matched) / max(n_target, 1)
        return np.asarray((n_target - matched + 0.5) * np.log1p(about))

    def _reflection_rate(self, matched: Floats | Integers | float) -> Floats:
        """Rate at which a hidden point's reflections are detected: as often as points are."""
        seen = (matched + 1.0) / (len(self.clouds.source) + 2.0)
        return np.asarray(seen if self.detection_rate is None else self.detection_rate)

    def clutter_about_points(self, fit: PointSetFit, which: Bools) -> Floats:
        """Density (K, n') of clutter about the places of some points (K, n), in parts of that about targets."""
        if not which.any():
            return np.zeros((len(which), len(self.clouds.target)))
        places, own = fit.places
        variance = own + (fit.scale**2)[:, None] * self.clouds.source_variance
        matched = (fit.assignments >= 0).sum(axis=1, keepdims=True)
        middle, axes = self._clutter_space[2:]
        return self.clutter.density_about_places(
            (places - middle) @ axes, variance, self._reflection_rate(matched) * which
        )

    def log_odds_of_left(self, taken: Bools) -> Floats:
        """Logarithm (K,) of the odds of as many clutter points as targets (K, n') that are taken leave."""
        return np.asarray(log_count_odds((taken.shape[1],), taken.shape[1])[0, taken.sum(axis=1)])

    def log_factors(self, fit: PointSetFit, bodies: Sequence[tuple[slice, slice]] = ()) -> Floats:
        """Logarithm (predictions + 1, K) of what each prediction of a motion makes of its density, and at last nothing.

        Where nothing is known of it, the whole object is where targets are, or its middle alone is, or any part.
        ``bodies``: rows and points of each, if they are of several; then the prior has a row for each.
        """
        matched, own, shown = fit.assignments >= 0, np.zeros(fit.assignments.shape, np.bool_), list[Floats]()
        for some in bodies or [(slice(None), slice(None))]:
            own[some] = True
            shown.append(log_region_factor(self.clouds.source[some[1]], matched[some], self.detection_rate))
        placement, in_view = self._place(fit, own), np.concatenate(shown)
        if self.prior is None:
            return placement.log_factors(in_view)[None]
        # what is known takes the place of where an object may be, as far as it tells, and not of what is in view of it
        factors = self.prior.log_factors(fit, self.box)
        for row, told in zip(factors, [*self.prior.tell_places(self.box), UNTOLD], strict=True):
            row += placement.log_factors(in_view, told)
        return factors

    def _place(self, fit: PointSetFit, own: Bools) -> Placement:
        """Where objects may be, by the places of their own points, (K, n) in all."""
        middle, axes = self._clutter_space[2:]
        low, high, left, above = self._clutter_box
        along = ((fit.places[0] - middle) @ axes).swapaxes(0, 1).copy()  # extrema of rows take the least time
        member = True if own.all() else own.T[..., None]
        first, last = along.min(axis=0, where=member, initial=np.inf), along.max(axis=0, where=member, initial=-np.inf)
        both = np.maximum(last, high) - np.minimum(first, low)
        share, matched = (last - first) / both, (fit.assignments >= 0).sum(axis=1)
        others, beyond = left[matched, None] + 1.0, above[matched, None]
        inside = others * np.log((high - low) / both)
        inside += np.log((0.5 * others + 0.5) * (beyond / (1.0 - share[..., None] * (1.0 - beyond)) @ WEIGHTS))
        if self.clouds.scaled:
            widest = np.maximum(share.max(axis=1, keepdims=True), 1e-300)  # all in one place where the scale vanishes
            inside = np.append(inside, np.log(RANGE_OF_LOG * widest), axis=1)
        if self.detection_rate is not None or bool((both <= high - low).all()):
            return Placement(inside, None, inside)
        seen = view_probability(along, low, high, len(self.clouds.target))
        in_view, n = np.where(fit.assignments.T >= 0, 1.0, seen * own.T).sum(axis=0), own.sum(axis=1)
        return Placement(
            inside,
            log_detection_count(in_view, matched) - log_detection_count(n, matched),
            np.log((high - low) / (high - low + last - first)),
        )

    @cached_property
    def _clutter_box(self) -> tuple[Floats, Floats, Floats, Floats]:
        """See `box_edges`."""
        clouds = self.clouds
        return box_edges(clouds.target, clouds.target_variance, len(clouds.source))

    def log_density(self, fit: PointSetFit) -> Floats:
        """Logarithm (K,) of the density of the matched targets, motion and σ integrated out."""
        nu, freedom = NOISE_FREEDOM, fit.dof
        inflated = np.asarray(log_student_factor(fit.chi2, freedom.astype(np.float64), nu))
        return np.where(np.isfinite(fit.chi2), fit.evidence + 0.5 * fit.chi2 + inflated, -np.inf)

    def gains(self, fit: PointSetFit, k: int) -> Floats:
        """Log-odds (n, n') of each correspondence given the rest of fitted assignment k, to first order."""
        kept = self._kept.get(fit.assignments[k].tobytes())
        one = fit.take(slice(k, k + 1)) if kept is None else kept.fit
        assignment = one.assignments[0]
        n, n_target = len(self.clouds.source), len(self.clouds.target)
        counts, own = self.log_counts, assignment >= 0
        matched = int(own.sum())
        # an added match is the last of m + 1, an existing one the last of m
        more = counts[min(matched + 1, n, n_target)] - counts[min(matched, n - 1, n_target - 1)]
        squared, gains = one.predictions(0)
        places = np.flatnonzero(own), assignment[own]
        chi2, freedom, size = float(one.chi2[0]), float(one.dof[0]), self.clouds.source.shape[1]
        now = float(log_student_factor(chi2, freedom, NOISE_FREEDOM))
        others = np.maximum(chi2 - squared[places], 0.0)
        gained = log_student_factor(chi2 + squared, freedom + size, NOISE_FREEDOM) - now
        gained[places] = now - log_student_factor(others, max(freedom - size, 0.0), NOISE_FREEDOM)
        (near,) = self.clutter_about_points(one, np.ones((1, n), np.bool_))
        gains += gained - self.clutter.log_density_of_each(used_mask(one.assignments, n_target)[0], near)
        gains += np.where(own, counts[matched] - counts[matched - 1], more)[:, None]
        if self.log_weights is not None:
            gains += self.log_weights
        if self.allowed is not None:
            gains[~self.allowed] = -np.inf
        gains[places] = np.maximum(gains[places], -1e9)
        return np.asarray(gains)

    @cached_property
    def log_counts(self) -> Floats:
        """Logarithm, by the number of matches, of two factors of the odds, with clutter about hidden points."""
        n, n_target = len(self.clouds.source), len(self.clouds.target)
        counts = _log_counts(n, n_target, self.detection_rate)
        return np.asarray(counts - self.log_hidden_clutter(np.arange(len(counts))))


@lru_cache(maxsize=64)
def _log_counts(n: int, n_target: int, detection_rate: float | None) -> Floats:
    """See `PointSetModel`."""
    m = np.arange(min(n, n_target) + 1)
    return np.asarray(log_detection_count(n, m, detection_rate) + log_count_odds((n_target,), len(m) - 1)[0])


def log_student_factor(chi2: Floats | float, freedom: Floats | float, nu: float) -> Floats:
    """Logarithm of exp(−χ²/2) averaged over the factor of the variances, whose powers σ^(−f) it takes along."""
    from scipy.special import gammaln  # slow to import

    power = 0.5 * (nu + freedom)
    return np.asarray(
        gammaln(power) - gammaln(0.5 * nu) - 0.5 * freedom * np.log(0.5 * nu) - power * np.log1p(chi2 / nu)
    )

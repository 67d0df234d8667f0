"""The model of two point sets of one space: log-odds of a labelling against clutter alone, the motion integrated out.

A source point is detected with the rate δ, at its place after the motion x' = s R x + t, with the noise of both points;
the other targets are a Poisson process of density λ f(y), see `rootmatch.model.clutter.Clutter`, in the volume V that
the targets span. Against the hypothesis that all targets are clutter, a labelling of m of n points by n' targets has
the odds

    ∫ δ^m (1 − δ)^(n − m) dδ · Γ(n' − m + ½) / Γ(n' + ½)
        · ∫ ∏ N(x'_j; s R x_i + t, s² σ_i² + σ_j²) / f(x'_j) dT / (V vol)

- δ is given, or integrated under a flat prior: every m is as probable, and each subset of m points.
- λ is integrated under Jeffreys' prior λ^(−½): the second factor, about 1/n'^m.
- f is uniform, or crowds about other targets, as markers of another object do: these are no evidence for this one.
- dT / (V vol) is the prior of the motion: every rotation, a translation that puts the object into V, and a scale that
  is flat in its logarithm (`rootmatch.problems.pose_fit.point_set_fit.DECADES`). It accounts for how vaguely a
  labelling determines the motion and for how many motions could fit by chance; the second factor accounts for the
  number of labellings.
- Where something is known of the motion, its prior takes the place of that volume (`rootmatch.model.motion_prior`).
- σ is that given times a factor, whose square has an inverse gamma prior of `NOISE_FREEDOM` degrees of freedom about 1:
  exp(−χ²/2) becomes a power of 1 + χ²/ν, as of Student's t.

Two parts are approximated: rotations in space, by Laplace's method with exact curvature, and the factor of σ, outside
of it. Translations and rotations of a plane are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.clutter import Clutter, clutter_in_space
from rootmatch.model.detection_model import log_odds_of_counts
from rootmatch.model.modes import uses_of
from rootmatch.model.motion_prior import MotionPrior
from rootmatch.model.priors import NOISE_FREEDOM
from rootmatch.problems.points import PointClouds
from rootmatch.problems.pose_fit.point_set_fit import PointSetFit, fitted_point_sets

PRESENT = 0.5
"""Prior probability that the object is among the targets. A round value."""


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
    weights : (n, n') array, optional
        Prior probabilities of the correspondences, up to a common factor.
    detection_rate : float, optional
        Probability that a point of the source is among the targets; unknown by default.
    prior : MotionPrior, optional
        What is known of the motion.
    present : float
        Probability that the targets show the source, before they are seen.
    """

    clouds: PointClouds
    mirror: bool = False
    allowed: Bools | None = None
    weights: Floats | None = None
    detection_rate: float | None = None
    prior: MotionPrior | None = None
    present: float = PRESENT

    @cached_property
    def log_volume(self) -> float:
        """Logarithm of the volume in which clutter lies, and the object."""
        return float(np.log(self._box[1]).sum())

    @cached_property
    def clutter(self) -> Clutter:
        """Where clutter lies."""
        along, extents = self._box
        return clutter_in_space(along, np.sqrt(self.clouds.target_variance), extents)

    @cached_property
    def _box(self) -> tuple[Floats, Floats]:
        return box_of(self.clouds.target, self.clouds.target_variance)

    def fit(self, assignments: Integers) -> PointSetFit:
        """The motion of each assignment (K, n)."""
        return fitted_point_sets(self.clouds, assignments, self.mirror)

    def log_odds(self, fit: PointSetFit) -> Floats:
        """Log-odds (K,) of each fitted assignment against the hypothesis that all targets are clutter."""
        matched = (fit.assignments >= 0).sum(axis=1)
        odds = self.log_density(fit) - self.log_volume + self._log_counts[matched] - self._log_clutter(fit.assignments)
        return np.asarray(odds + self._log_weights(fit.assignments) + self.log_prior(fit))

    def _log_clutter(self, assignments: Integers) -> Floats:
        """Logarithm (K,) of the density of the matched targets if they are clutter."""
        taken = uses_of(assignments, len(self.clouds.target))
        return np.asarray(taken @ self.clutter.log_density - self.clutter.log_first(taken))

    def log_left(self, taken: Bools) -> Floats:
        """Logarithm (K,) of the odds of as many clutter points as targets (K, n') that are taken leave."""
        return np.asarray(log_odds_of_counts((taken.shape[1],), taken.shape[1])[0, taken.sum(axis=1)])

    def log_prior(self, fit: PointSetFit) -> Floats:
        """Logarithm (K,) of the factor that what is known of the motion puts on the odds; 0 if nothing is."""
        if self.prior is None:
            return np.zeros(len(fit.scale))
        return np.asarray(np.logaddexp.reduce(self.prior.log_factors(fit, self.log_volume), axis=0))

    def held(self, fit: PointSetFit) -> Integers:
        """The prediction (K,) by which each fitted assignment is most probable; −1 if by none."""
        assert self.prior is not None
        first = np.argmax(self.prior.log_factors(fit, self.log_volume), axis=0)
        return np.where(first < len(self.prior.predictions), first, -1)

    def log_density(self, fit: PointSetFit) -> Floats:
        """Logarithm (K,) of the density of the matched targets, motion and σ integrated out."""
        nu, freedom = NOISE_FREEDOM, fit.dof
        inflated = np.asarray(student(fit.chi2, freedom.astype(np.float64), nu))
        return np.where(np.isfinite(fit.chi2), fit.evidence + 0.5 * fit.chi2 + inflated, -np.inf)

    def gains(self, fit: PointSetFit, k: int) -> Floats:
        """Log-odds (n, n') of each correspondence given the rest of fitted assignment k, to first order."""
        matched = int((fit.assignments[k] >= 0).sum())
        n, n_target = len(self.clouds.source), len(self.clouds.target)
        counts, own = self._log_counts, fit.assignments[k] >= 0
        # an added match is the last of m + 1, an existing one the last of m
        more = counts[min(matched + 1, n, n_target)] - counts[min(matched, n - 1, n_target - 1)]
        gains = fit.densities(k) - self.clutter.log_density
        gains += np.where(own, counts[matched] - counts[matched - 1], more)[:, None]
        if self.weights is not None:
            with np.errstate(divide="ignore"):
                gains += np.log(self.weights)
        if self.allowed is not None:
            gains[~self.allowed] = -np.inf
        places = np.flatnonzero(own), fit.assignments[k][own]
        gains[places] = np.maximum(gains[places], -1e9)
        return np.asarray(gains)

    @cached_property
    def _log_counts(self) -> Floats:
        """Logarithm, by the number of matches, of the first two factors of the odds."""
        from scipy.special import betaln, gammaln  # slow to import

        n, n_target = len(self.clouds.source), len(self.clouds.target)
        m = np.arange(min(n, n_target) + 1)
        if self.detection_rate is None:
            detected = betaln(m + 1.0, n - m + 1.0)
        else:
            detected = m * np.log(self.detection_rate) + (n - m) * np.log1p(-self.detection_rate)
        return np.asarray(detected + gammaln(n_target - m + 0.5) - gammaln(n_target + 0.5))

    def _log_weights(self, assignments: Integers) -> Floats:
        """Sum (K,) of the logarithms of the prior weights of an assignment's matches."""
        if self.weights is None:
            return np.zeros(len(assignments))
        matched = assignments >= 0
        with np.errstate(divide="ignore"):
            log = np.log(self.weights)
        return np.asarray(
            np.where(matched, log[np.arange(log.shape[0]), np.where(matched, assignments, 0)], 0.0).sum(1)
        )


def student(chi2: Floats, freedom: Floats, nu: float) -> Floats:
    """Logarithm of exp(−χ²/2) averaged over the factor of the variances, whose powers σ^(−f) it takes along."""
    from scipy.special import gammaln  # slow to import

    power = 0.5 * (nu + freedom)
    return np.asarray(
        gammaln(power) - gammaln(0.5 * nu) - 0.5 * freedom * np.log(0.5 * nu) - power * np.log1p(chi2 / nu)
    )


def box_of(points: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Points (n, k) along their principal axes, and extents (k,) of the box they fill, corrected for n uniform ones.

    Whatever the axes of the frame, points of a plane span a thin box; it is as thick as the noise.
    """
    centred = points - points.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1]
    extent = np.ptp(along, axis=0) * ((len(points) + 1) / max(len(points) - 1, 1))
    return along, np.asarray(np.maximum(extent, 2.0 * np.sqrt(2.0 * np.pi * float(variance.max()))))

"""Priors of a pose: densities over rotations and positions of a body's centre, before the image is seen.

Each prior answers one question: its logarithm about given poses, as precision, slope and value. A broad factor is
represented by a normal distribution of the same volume about the pose itself, so a parameter that no detection
determines counts as the whole of that volume and never as more.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rootmatch.algebra.rotation import cross_matrix, rotation_from_vector, rotation_vector
from rootmatch.arrays import Floats, Integers
from rootmatch.model.compiled.prior_terms import mixture_terms
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_prior import PosePrior
from rootmatch.problems.pose_fit.reference_point import about_point

FIELD = 2.0
"""Solid angle in steradians in which a body may be, if the image's size is not known: about 80° by 80°. A round
value; a factor of two in it is 0.7 in the logarithm of the odds."""
DEPTHS = 100.0
"""Ratio of a body's largest to its smallest distance, each octave equally probable. A round value; ten times as much is
0.4."""
ROTATIONS = 8.0 * math.pi**2
"""Volume of all rotations, by rotation vectors."""
ANY_TURN = 2.0 * math.pi / ROTATIONS ** (2.0 / 3.0)
"""Precision of a normal distribution of that volume."""
TURNS = 2.0 * math.pi
"""Length of all rotations about an axis."""
EXACT = 1e-6
"""Smallest standard deviation of a prediction: in radians, relative to the distance, and relative to other
directions."""
LEAST_TILT = 1e-4
"""Standard deviation, in radians, used for a vertical that is stated as exact."""
LEAST = 3
"""Matches of a mode: with fewer a pose is not determined unless it is predicted, and a body that shows no more is not
told from clutter."""


BroadNumbers = tuple[float, float, float, float, float]
Mixture = tuple[tuple[Floats, ...], BroadNumbers]
"""Predictions and a broad prior with their shares, see `rootmatch.model.compiled.prior_terms.mixture_terms`."""


class Terms(NamedTuple):
    """A prior's logarithm about K poses, as −½ (x − d)ᵀ P (x − d) + c for a step x = (ω, τ) from the pose."""

    precision: Floats
    """P, (K, 6, 6)."""
    slope: Floats
    """P d, (K, 6): towards the prior's mean."""
    squared: Floats
    """dᵀ P d, (K,)."""
    log_density: Floats
    """c, (K,): logarithm of the density at its peak."""


class PoseDensity(ABC):
    """A density over rotations R (left perturbation ω, rad) and positions of the body's centre in the camera frame."""

    @property
    def least(self) -> int:
        """Matches of a mode."""
        return LEAST

    @property
    def for_kernels(self) -> Mixture | None:
        """The density as kernels take it; None if it is not a mixture of predicted poses and a broad one."""
        return None

    @abstractmethod
    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """The logarithm of the density about poses (K, 3, 3) and (K, 3)."""


@dataclass(frozen=True)
class Broad(PoseDensity):
    """Any rotation, at any place in the field of view, at any distance within two decades.

    p(R, t) = 1 / (8π²) · 1 / (Ω (‖t‖² + ρ²)^(3/2) log D) for a field of Ω steradians and distances within a factor D.
    No octave is more probable than another, down to the body's radius ρ: nearer, the camera is amid its points, and no
    place there is more probable than another. Nothing else in it has a unit of length.

    Parameters
    ----------
    radius : float
        Root mean square distance of the body's points from their centre.
    """

    radius: float = 0.0

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """See `PoseDensity.terms`."""
        return _mixture(self.for_kernels, rotation, position)[0]

    @cached_property
    def for_kernels(self) -> Mixture:
        """See `PoseDensity.for_kernels`."""
        return NO_PREDICTIONS, self.with_share(0.0)

    def with_share(self, log_share: float) -> BroadNumbers:
        """Its numbers as one of several components."""
        return ANY_TURN, FIELD, math.log(DEPTHS), log_share - math.log(ROTATIONS), self.radius

    def of_position(self, position: Floats) -> tuple[Floats, Floats]:
        """Precision (K, 3, 3) and log density (K,) of positions (K, 3)."""
        terms = self.terms(np.broadcast_to(np.eye(3), (len(position), 3, 3)), position)
        return terms.precision[:, 3:, 3:], terms.log_density + math.log(ROTATIONS)


@dataclass(frozen=True, eq=False)
class Known(PoseDensity):
    """A rotation, a vertical or a position of the body's origin that is known, with a normal error; broad in the rest.

    Parameters
    ----------
    prior : PosePrior
    centre : (3,) array
        Of the body, in its frame.
    radius : float
        As of `Broad`.
    """

    prior: PosePrior
    centre: Floats
    radius: float = 0.0

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """See `PoseDensity.terms`."""
        count = len(rotation)
        precision, slope = np.zeros((count, 6, 6)), np.zeros((count, 6))
        precision[:, :3, :3], slope[:, :3], squared, log_density = self._of_rotation(rotation)
        if self._place is None:
            precision[:, 3:, 3:], log_position = Broad(self.radius).of_position(position)
            return Terms(precision, slope, squared, log_density + log_position)
        place, weight, log_peak = self._place
        arm = rotation @ self.centre
        off = place - (position - arm)
        rows = np.zeros((count, 3, 6))  # how the origin moves with a step of the centre
        rows[:, :, :3], rows[:, :, 3:] = cross_matrix(arm), np.eye(3)
        precision += rows.swapaxes(1, 2) @ weight @ rows
        slope += (rows.swapaxes(1, 2) @ (weight @ off[..., None]))[..., 0]
        squared = squared + ((off @ weight) * off).sum(axis=1)
        return Terms(precision, slope, squared, log_density + log_peak)

    def about(self, pose: Pose) -> Pose:
        """The normal distribution that it is about a pose, to first order; very wide in what is not known."""
        position = pose.t + pose.R @ self.centre
        terms = self.terms(pose.R[None], position[None])
        scale = np.sqrt(np.diag(terms.precision[0]))
        covariance = np.linalg.inv(terms.precision[0] / np.outer(scale, scale)) / np.outer(scale, scale)
        step = covariance @ terms.slope[0]
        R = rotation_from_vector(step[None, :3])[0] @ pose.R
        return Pose.unchecked(R, *about_point(R, position + step[3:], covariance, -self.centre))

    def _of_rotation(self, rotation: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Precision (K, 3, 3), slope (K, 3), squared deviation (K,) and log density (K,) of rotations (K, 3, 3)."""
        count, down = len(rotation), self.prior.down
        if self._turn is not None:
            mean, weight, log_peak = self._turn
            step = rotation_vector(mean @ rotation.swapaxes(1, 2))
            slope = step @ weight
            same = np.broadcast_to(weight, (count, 3, 3))
            return same, slope, (slope * step).sum(axis=1), np.full(count, log_peak)
        if down is None:
            any_turn = np.broadcast_to(ANY_TURN * np.eye(3), (count, 3, 3))
            return any_turn, np.zeros((count, 3)), np.zeros(count), np.full(count, -math.log(ROTATIONS))
        source, camera, noise = down
        sigma = max(noise, LEAST_TILT)
        now = rotation @ source
        off = camera - now
        across = -cross_matrix(now)  # how the vertical moves with a turn
        about = now[:, :, None] * now[:, None] * (2.0 * math.pi / TURNS**2)
        weight = across.swapaxes(1, 2) @ across / sigma**2 + about
        slope = (across.swapaxes(1, 2) @ off[..., None])[..., 0] / sigma**2
        peak = -math.log(2.0 * math.pi * sigma**2 * TURNS)
        return weight, slope, (off**2).sum(axis=1) / sigma**2, np.full(count, peak)

    @cached_property
    def _turn(self) -> tuple[Floats, Floats, float] | None:
        """The rotation that is known, the precision of it, and the logarithm of its density at the peak."""
        turn = self.prior.turn
        return None if turn is None else (turn[0], *_peak(turn[1], EXACT))

    @cached_property
    def _place(self) -> tuple[Floats, Floats, float] | None:
        """The position that is known, its precision, and the logarithm of its density at the peak."""
        place = self.prior.place
        return None if place is None else (place[0], *_peak(place[1], EXACT * float(np.linalg.norm(place[0]))))


def _peak(covariance: Floats, least: float) -> tuple[Floats, float]:
    """Precision and log density at the peak of a normal distribution no narrower than ``least``."""
    whole = covariance + max(least, 1e-150) ** 2 * np.eye(len(covariance))
    return np.asarray(np.linalg.inv(whole), np.float64), -0.5 * float(np.linalg.slogdet(2.0 * math.pi * whole)[1])


@dataclass(frozen=True, eq=False)
class Gaussian(PoseDensity):
    """A predicted pose: normal in all six parameters, with the tails of a t-distribution.

    The covariance may be too small, by any factor as probably as that of an estimate from some samples. So says a
    t-distribution; but about its peak it is narrower than the normal one, as if an image had shown that the covariance
    is too large. A pose that the image hardly tells is near because of the prediction alone, which would count
    (ν + 6) / ν times in each frame. So the tails begin at the mean squared deviation, 6, where both slopes are equal.

    Parameters
    ----------
    rotation, position : (3, 3) and (3,) arrays
        Of the mean; the position is that of the body's centre.
    covariance : (6, 6) array
        Covariance of (ω, τ).
    freedom : float
        Of the tails: samples that a covariance of all six counts for.
    """

    rotation: Floats
    position: Floats
    covariance: Floats
    freedom: float = math.inf

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """See `PoseDensity.terms`."""
        return _mixture(self.for_kernels, rotation, position)[0]

    @cached_property
    def for_kernels(self) -> Mixture:
        """See `PoseDensity.for_kernels`."""
        return _packed([self], [0.0]), Broad().with_share(-math.inf)

    def tail_weight(self, squared: Floats) -> Floats:
        """How much the prediction counts at a squared deviation (K,) from it: 1 up to 6, the mean of six parameters."""
        if math.isinf(self.freedom):
            return np.ones_like(squared)
        return np.asarray((self.freedom + 6.0) / (self.freedom + np.maximum(squared, 6.0)))

    @cached_property
    def bounded(self) -> Floats:
        """The covariance, no more certain than `EXACT` in any direction."""
        distance = max(math.sqrt(self.position @ self.position), 1e-300)
        least = EXACT * np.array([1.0, 1.0, 1.0, distance, distance, distance])
        scale = np.sqrt(np.maximum(self.covariance.diagonal(), least**2))
        unit = scale[:, None] * scale
        return np.asarray((self.covariance / unit + EXACT * np.eye(6)) * unit)

    @cached_property
    def _precision(self) -> tuple[Floats, float]:
        """The precision (6, 6), and the logarithm of the density at its peak."""
        logarithm = 0.5 * float(np.linalg.slogdet(2.0 * math.pi * self.bounded)[1]) + _log_mass(self.freedom)
        return np.asarray(np.linalg.inv(self.bounded), np.float64), -logarithm


@dataclass(frozen=True, eq=False)
class Doubted(PoseDensity):
    """Predictions that may all be wrong: a mixture of them and of what is known without any.

    About each pose the largest component stands for the mixture; the others are negligible where one of them is large.

    Parameters
    ----------
    predictions : sequence of Gaussian or Known
        At least one.
    log_shares : sequence of float
        Logarithm of the share of each; they add up to 1 less the doubt.
    without : PoseDensity
    doubt : float
        Share of the latter.
    """

    predictions: Sequence[Gaussian | Known]
    log_shares: Sequence[float]
    without: PoseDensity
    doubt: float

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """See `PoseDensity.terms`."""
        return self._terms(rotation, position)[0]

    @property
    def least(self) -> int:
        """See `PoseDensity`: one match is one coincidence, which a clutter point that stands still repeats."""
        return 2 if any(isinstance(one, Gaussian) for one in self.predictions) else 3

    def prediction_of(self, rotation: Floats, position: Floats) -> Integers:
        """The prediction (K,) of the highest density at each of some poses; −1 if that without them is higher."""
        first = self._terms(rotation, position)[1]
        return np.where(first < len(self.predictions), first, -1)

    @cached_property
    def for_kernels(self) -> Mixture | None:
        """See `PoseDensity.for_kernels`."""
        known = [one for one in self.predictions if isinstance(one, Gaussian)]
        if len(known) < len(self.predictions) or not isinstance(self.without, Broad):
            return None
        return _packed(known, self.log_shares), self.without.with_share(math.log(self.doubt))

    def _terms(self, rotation: Floats, position: Floats) -> tuple[Terms, Integers]:
        """The terms of the largest component about each pose, and which it is."""
        if self.for_kernels is not None:
            return _mixture(self.for_kernels, rotation, position)
        every, shares = [], [*self.log_shares, math.log(self.doubt)]
        for prior, share in zip([*self.predictions, self.without], shares, strict=True):
            precision, slope, squared, log_density = prior.terms(rotation, position)
            every.append(Terms(precision, slope, squared, log_density + share))
        first = np.asarray(np.argmax([one.log_density - 0.5 * one.squared for one in every], axis=0))
        rows = np.arange(len(rotation))
        return Terms(*(np.stack(column)[first, rows] for column in zip(*every, strict=True))), first


def _log_mass(freedom: float) -> float:
    """Logarithm of the integral of e^(−d²/2) over six parameters with the tails of `Gaussian`, over that without."""
    if math.isinf(freedom):
        return 0.0
    half, inner, outer = 0.5 * freedom, freedom / (freedom + 6.0), 6.0 / (freedom + 6.0)
    within = 1.0 - 8.5 * math.exp(-3.0)  # of χ² with six degrees of freedom
    tail = (half * half + half**3 * outer + 0.5 * half**3 * (half + 1.0) * outer**2) / ((half + 1.0) * (half + 2.0))
    return math.log(within + tail * math.exp(-3.0) / inner**3)


def _packed(predictions: Sequence[Gaussian], log_shares: Sequence[float]) -> tuple[Floats, ...]:
    """Predictions with their shares as arrays for the kernel."""
    each = [one._precision for one in predictions]
    return (
        np.array([one.rotation for one in predictions]),
        np.array([one.position for one in predictions]),
        np.array([whole for whole, _ in each]),
        np.array([peak + share for (_, peak), share in zip(each, log_shares, strict=True)]),
        np.array([one.freedom for one in predictions], dtype=float),
    )


def _mixture(mixture: Mixture, rotation: Floats, position: Floats) -> tuple[Terms, Integers]:
    """The terms of the largest component about poses (K, 3, 3) and (K, 3), and which it is; the broad one is last."""
    count = len(rotation)
    terms = Terms(np.empty((count, 6, 6)), np.empty((count, 6)), np.empty(count), np.empty(count))
    which = np.empty(count, np.int64)
    mixture_terms((np.array(rotation), np.array(position)), *mixture, tuple(terms), which)
    return terms, which


NO_PREDICTIONS = np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 6, 6)), np.empty(0), np.empty(0)

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
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross_matrix, rotation_vector

Floats = NDArray[np.float64]

FIELD = 2.0
"""Solid angle in steradians in which a body may be, if the image's size is not known: about 80° by 80°. A round
value; a factor of two in it is 0.7 in the logarithm of the odds."""
DEPTHS = 100.0
"""Ratio of a body's largest to its smallest distance, each octave equally probable. A round value; ten times as much is
0.4."""
ROTATIONS = 8.0 * math.pi**2
"""Volume of all rotations, by rotation vectors."""
TURNS = 2.0 * math.pi
"""Length of all rotations about an axis."""
EXACT = 1e-6
"""Smallest standard deviation of a prediction: in radians, relative to the distance, and relative to other
directions."""
LEAST_TILT = 1e-4
"""Standard deviation, in radians, used for a vertical that is stated as exact."""


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


class PosePrior(ABC):
    """A density over rotations R (left perturbation ω, rad) and positions of the body's centre in the camera frame.

    Attributes
    ----------
    least : int
        Matches of a mode: with fewer than three a pose is not determined unless it is predicted, and a body that shows
        no more is not told from clutter.
    """

    least: ClassVar[int] = 3

    @abstractmethod
    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """Its logarithm about poses (K, 3, 3) and (K, 3)."""


@dataclass(frozen=True)
class Broad(PosePrior):
    """Any rotation, at any place in the field of view, at any distance within two decades.

    p(R, t) = 1 / (8π²) · 1 / (Ω ‖t‖³ log D) for a field of Ω steradians and distances within a factor D. Nothing in it
    has a unit of length.
    """

    field: float = FIELD
    depths: float = DEPTHS

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """See `PosePrior.terms`."""
        count = len(rotation)
        precision = np.zeros((count, 6, 6))
        precision[:, :3, :3] = 2.0 * math.pi / ROTATIONS ** (2.0 / 3.0) * np.eye(3)
        precision[:, 3:, 3:], log_position = self.of_position(position)
        zero = np.zeros((count, 6))
        return Terms(precision, zero, np.zeros(count), log_position - math.log(ROTATIONS))

    def of_position(self, position: Floats) -> tuple[Floats, Floats]:
        """Precision (K, 3, 3) and log density (K,) of positions (K, 3)."""
        distance = np.linalg.norm(position, axis=1)
        along = position / distance[:, None]
        ray = along[:, :, None] * along[:, None]
        depth = math.log(self.depths)
        # normal distributions with the areas Ω r² across the ray and the length r log D along it
        precision = 2.0 * math.pi * ((np.eye(3) - ray) / self.field + ray / depth**2) / distance[:, None, None] ** 2
        return precision, -np.log(self.field * depth) - 3.0 * np.log(distance)


@dataclass(frozen=True, eq=False)
class Upright(PosePrior):
    """A measured vertical: two angles of the rotation are normal, the third is any, and the position is broad.

    Parameters
    ----------
    world, camera : (3,) arrays
        The vertical in the frames of the body and of the camera, of any length.
    noise : float
        Standard deviation of the latter on each of two axes, in radians.
    position : Broad
    """

    world: Floats
    camera: Floats
    noise: float
    position: Broad = Broad()

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """See `PosePrior.terms`."""
        count, sigma = len(rotation), max(self.noise, LEAST_TILT)
        down = rotation @ (self.world / np.linalg.norm(self.world))
        off = self.camera / np.linalg.norm(self.camera) - down
        across = -cross_matrix(down)  # how the vertical moves with a turn
        about = down[:, :, None] * down[:, None] * (2.0 * math.pi / TURNS**2)
        precision, slope = np.zeros((count, 6, 6)), np.zeros((count, 6))
        precision[:, :3, :3] = across.swapaxes(1, 2) @ across / sigma**2 + about
        precision[:, 3:, 3:], log_position = self.position.of_position(position)
        slope[:, :3] = (across.swapaxes(1, 2) @ off[..., None])[..., 0] / sigma**2
        log_density = log_position - math.log(2.0 * math.pi * sigma**2 * TURNS)
        return Terms(precision, slope, (off**2).sum(axis=1) / sigma**2, log_density)


@dataclass(frozen=True, eq=False)
class Gaussian(PosePrior):
    """A predicted pose: normal in all six parameters, or in the rotation or the position alone, and broad in the rest.

    Parameters
    ----------
    rotation, position : (3, 3) and (3,) arrays
        Of the mean; the position is that of the body's centre.
    covariance : (6, 6) array
        Covariance of (ω, τ); infinite on the diagonal for three parameters if nothing is known of them.
    broad : Broad
        Of those.
    freedom : float
        Degrees of freedom that a covariance of all six counts for: it may be too small, and is as probable to be by
        any factor as that of so many samples.
    """

    rotation: Floats
    position: Floats
    covariance: Floats
    broad: Broad = Broad()
    freedom: float = math.inf

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """See `PosePrior.terms`."""
        count = len(rotation)
        known, whole, log_peak = self._known
        step = np.concatenate([rotation_vector(self.rotation @ rotation.swapaxes(1, 2)), self.position - position], 1)
        step[:, ~known] = 0.0
        if known.all():
            slope = step @ whole
            same = np.broadcast_to(whole, (count, 6, 6))
            return self._with_tails(Terms(same, slope, (slope * step).sum(axis=1), np.full(count, log_peak)))
        terms = self.broad.terms(rotation, position)
        precision = np.where(np.outer(known, known), whole, terms.precision)
        precision[:, ~np.equal.outer(known, known)] = 0.0
        log_density = np.full(count, log_peak)
        if not known[:3].all():
            log_density = log_density - math.log(ROTATIONS)
        if not known[3:].all():
            log_density = log_density + self.broad.of_position(position)[1]
        slope = step @ whole
        return Terms(precision, slope, (slope * step).sum(axis=1), log_density)

    def _with_tails(self, terms: Terms) -> Terms:
        """The same with a factor on the covariance integrated out: value, slope and curvature of a t-distribution.

        Of a factor s² under an inverse gamma distribution of ν degrees of freedom, p ∝ (1 + d²/ν)^(−(ν+6)/2).
        """
        freedom = self.freedom
        if math.isinf(freedom):
            return terms
        half, weight = 0.5 * freedom, self.tail_weight(terms.squared)
        peak = math.lgamma(half + 3.0) - math.lgamma(half) - 3.0 * math.log(half)
        squared = weight * terms.squared
        log_density = terms.log_density + peak - (half + 3.0) * np.log1p(terms.squared / freedom) + 0.5 * squared
        return Terms(weight[:, None, None] * terms.precision, weight[:, None] * terms.slope, squared, log_density)

    def tail_weight(self, squared: Floats) -> Floats:
        """How much the prediction counts at a squared deviation (K,) from it: 1 at 6, the mean of six parameters."""
        if math.isinf(self.freedom):
            return np.ones_like(squared)
        return np.asarray((self.freedom + 6.0) / (self.freedom + squared))

    @property
    def bounded(self) -> Floats:
        """The covariance of what is known, no more certain than `EXACT` in any direction."""
        return self._invertible(self._known[0])

    @cached_property
    def _known(self) -> tuple[NDArray[np.bool_], Floats, float]:
        """Which parameters are known, the precision of those (6, 6), and the logarithm of the density at its peak."""
        known = np.isfinite(np.diag(self.covariance))
        own = self._invertible(known)
        whole = np.zeros((6, 6))
        whole[np.ix_(known, known)] = np.linalg.inv(own)
        return known, whole, -0.5 * float(np.linalg.slogdet(2.0 * math.pi * own)[1])

    def _invertible(self, known: NDArray[np.bool_]) -> Floats:
        least = EXACT * np.repeat([1.0, max(float(np.linalg.norm(self.position)), 1e-300)], 3)[known]
        own = self.covariance[np.ix_(known, known)]
        scale = np.sqrt(np.maximum(np.diag(own), least**2))
        return np.asarray((own / np.outer(scale, scale) + EXACT * np.eye(len(scale))) * np.outer(scale, scale))


@dataclass(frozen=True, eq=False)
class Doubted(PosePrior):
    """Predictions that may all be wrong: a mixture of them and of what is known without any.

    About each pose the largest component stands for the mixture; the others are negligible where one of them is large.

    Parameters
    ----------
    predictions : sequence of Gaussian
        At least one.
    log_shares : sequence of float
        Logarithm of the share of each; they add up to 1 less the doubt.
    without : PosePrior
    doubt : float
        Share of the latter.
    """

    least: ClassVar[int] = 2  # one match is one coincidence, which a clutter point that stands still repeats
    predictions: Sequence[Gaussian]
    log_shares: Sequence[float]
    without: PosePrior
    doubt: float

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """See `PosePrior.terms`."""
        every = self._components(rotation, position)
        first, rows = _highest(every), np.arange(len(rotation))
        if (first == first[:1]).all() and len(first):
            return every[int(first[0])]
        return Terms(*(np.stack(column)[first, rows] for column in zip(*every, strict=True)))

    def prediction_of(self, rotation: Floats, position: Floats) -> NDArray[np.int64]:
        """The prediction (K,) of the highest density at each of some poses; −1 if that without them is higher."""
        first = _highest(self._components(rotation, position))
        return np.where(first < len(self.predictions), first, -1)

    def _components(self, rotation: Floats, position: Floats) -> list[Terms]:
        shares = [*self.log_shares, math.log(self.doubt)]
        terms = (prior.terms(rotation, position) for prior in (*self.predictions, self.without))
        return [
            Terms(precision, slope, squared, log_density + share)
            for (precision, slope, squared, log_density), share in zip(terms, shares, strict=True)
        ]


def _highest(every: list[Terms]) -> NDArray[np.int64]:
    """Which of some components is the largest at each of the poses that their terms are about."""
    return np.asarray(np.argmax([one.log_density - 0.5 * one.squared for one in every], axis=0))

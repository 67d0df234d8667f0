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
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.frozen import once
from rootmatch.model.compiled.known_terms import fill_prior_terms
from rootmatch.model.priors import DEPTHS

FIELD = 2.0
"""Solid angle in steradians in which a body may be, if the image's size is not known: about 80° by 80°. A round
value; a factor of two in it is 0.7 in the logarithm of the odds."""
ROTATIONS = 8.0 * math.pi**2
"""Volume of all rotations, by rotation vectors."""
ANY_TURN = 2.0 * math.pi / ROTATIONS ** (2.0 / 3.0)
"""Precision of a normal distribution of that volume."""
TURNS = 2.0 * math.pi
"""Length of all rotations about an axis."""
EXACT = 1e-6
"""Smallest standard deviation of a prediction: in radians, relative to the distance, and relative to other
directions."""
LOG_PEAK = 3.0 * math.log(2.0 * math.pi)
"""Of a standard normal distribution of six parameters: less this is the logarithm of its density at its peak."""
VAGUE = 1e-3
"""Variance of a place over its squared distance below which it is hardly vaguer by being in view: by less than the
same part. A round value."""
RIDGE = EXACT * np.eye(6)
"""Of a covariance in units of its standard deviations."""
MINIMUM = 3
"""Matches of a mode: with fewer a pose is not determined unless it is predicted, and a body that shows no more is not
told from clutter."""


BroadNumbers = tuple[float, float, float, float, float]
Knowledge = tuple[tuple[Floats, Floats], tuple[Floats, Floats, Floats], tuple[Floats, Floats, Floats], Floats]
"""M pieces of partial knowledge, each a factor on the broad prior: rotations (M, 3, 3) with their precisions
(M, 3, 3); directions (M, 3) in the frame of the points and in the camera's, with their concentrations (M,); positions
(M, 3) of the origin with their precisions (M, 3, 3), and the centre (M, 3); zero where nothing is known. Last the
logarithms (M,) of what they are at their peaks, of any rotation, and of the share of each."""
Mixture = tuple[tuple[Floats, ...], BroadNumbers, Knowledge]
"""Predictions, a broad prior, and partial knowledge, with their shares: `rootmatch.model.compiled.known_terms`."""


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


def largest_component(components: Terms) -> Integers:
    """The largest of components (K, C, …) at each of K poses."""
    return np.asarray(np.argmax(components.log_density - 0.5 * components.squared, axis=1))


class PoseDensity(ABC):
    """A density over rotations R (left perturbation ω, rad) and positions of the body's centre in the camera frame."""

    @property
    def minimum(self) -> int:
        """Matches of a mode."""
        return MINIMUM

    @property
    def for_kernels(self) -> Mixture | None:
        """The density as kernels take it; None if they do not."""
        return None

    @abstractmethod
    def components(self, rotation: Floats, position: Floats) -> Terms:
        """The logarithm of each component (K, C, …) about poses (K, 3, 3) and (K, 3).

        Which of them counts about a pose is known only with its detections: a precise one is small about the pose of
        few detections alone, and large about that of both.
        """

    def terms(self, rotation: Floats, position: Floats) -> Terms:
        """The logarithm of the largest component at each of some poses: (K, …)."""
        every = self.components(rotation, position)
        first = largest_component(every)
        rows = np.arange(len(first))
        return Terms(*(one[rows, first] for one in every))


class Mixed(PoseDensity):
    """A density that kernels take."""

    @property
    @abstractmethod
    def for_kernels(self) -> Mixture:
        """See `PoseDensity.for_kernels`."""

    def components(self, rotation: Floats, position: Floats) -> Terms:
        """See `PoseDensity.components`."""
        return self._components(rotation, position)[0]

    def _components(self, rotation: Floats, position: Floats) -> tuple[Terms, Integers]:
        """Those, and the largest prediction (K,) in the first one; their number for the broad prior."""
        known = self.for_kernels
        count, rows = len(rotation), 1 + len(known[2][-1])
        precision, slope = np.empty((count, rows, 6, 6)), np.empty((count, rows, 6))
        terms = Terms(precision, slope, np.empty((count, rows)), np.empty((count, rows)))
        which = np.empty(count, np.int64)
        fill_prior_terms((np.array(rotation), np.array(position)), known, tuple(terms), which)
        return terms, which


@dataclass(frozen=True)
class Broad(Mixed):
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

    @once
    def for_kernels(self) -> Mixture:
        """See `PoseDensity.for_kernels`."""
        return NO_PREDICTIONS, self.weigh_share(0.0), NO_KNOWLEDGE

    def weigh_share(self, log_share: float) -> BroadNumbers:
        """Its numbers as one of several components."""
        return ANY_TURN, FIELD, math.log(DEPTHS), log_share - math.log(ROTATIONS), self.radius

    def position_terms(self, position: Floats) -> tuple[Floats, Floats]:
        """Precision (K, 3, 3) and log density (K,) of positions (K, 3)."""
        terms = self.terms(np.broadcast_to(np.eye(3), (len(position), 3, 3)), position)
        return terms.precision[:, 3:, 3:], terms.log_density + math.log(ROTATIONS)


@dataclass(frozen=True, eq=False)
class Gaussian(Mixed):
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

    @once
    def for_kernels(self) -> Mixture:
        """See `PoseDensity.for_kernels`."""
        return pack_predictions([(self, 0.0)], math.inf), Broad().weigh_share(-math.inf), NO_KNOWLEDGE

    def tail_weight(self, squared: Floats) -> Floats:
        """How much the prediction counts at a squared deviation (K,) from it: 1 up to 6, the mean of six parameters."""
        if math.isinf(self.freedom):
            return np.ones_like(squared)
        return np.asarray((self.freedom + 6.0) / (self.freedom + np.maximum(squared, 6.0)))

    @once
    def bounded_covariance(self) -> Floats:
        """The covariance, no more certain than `EXACT` in any direction, and of no more than all rotations."""
        distance = max(math.sqrt(self.position @ self.position), 1e-300)
        minimum = EXACT * np.array([1.0, 1.0, 1.0, distance, distance, distance])
        scale = np.sqrt(np.maximum(self.covariance.diagonal(), minimum**2))
        unit = scale[:, None] * scale
        bounded = np.asarray((self.covariance / unit + RIDGE) * unit)
        if (bounded[0, 0] + bounded[1, 1] + bounded[2, 2]) * ANY_TURN <= 1.0:
            return bounded
        values, vectors = np.linalg.eigh(bounded[:3, :3])
        kept, along = np.minimum(values, 1.0 / ANY_TURN), vectors.T @ bounded[:3, 3:]
        # the rotation's block is put together anew: after a long pause, all of a difference from it is rounding
        change = along.T / values  # of the position by the rotation
        bounded[:3, :3] = vectors * kept @ vectors.T
        bounded[:3, 3:] = vectors * (kept / values) @ along
        bounded[3:, :3] = bounded[:3, 3:].T
        bounded[3:, 3:] -= change * (values - kept) @ change.T
        return bounded

    def log_gain(self, radius: float) -> float:
        """Logarithm of what restricting a normal distribution to where a body may be at all adds to its density.

        So a vague one is never less than the density of any place, as of `Broad` about the predicted one.
        """
        reach2, spread = float(self.position @ self.position) + radius**2, self.bounded_covariance[3:, 3:]
        if spread[0, 0] + spread[1, 1] + spread[2, 2] < VAGUE * reach2:
            return 0.0
        precision, _ = Broad(radius).position_terms(self.position[None])
        return 0.5 * float(np.linalg.slogdet(np.eye(3) + spread @ precision[0])[1])


@dataclass(frozen=True, eq=False)
class Doubted(Mixed):
    """Predictions that may all be wrong: a mixture of them and of what is known without any.

    The component that explains most with the detections stands for the mixture; of the predicted poses, from which fits
    start, the one that is largest about a pose.

    Parameters
    ----------
    predictions : sequence of Gaussian or of `rootmatch.model.known_density.Known`
        At least one.
    log_shares : sequence of float
        Logarithm of the share of each; they add up to 1 less the doubt.
    without : PoseDensity
    doubt : float
        Share of the latter.
    places : sequence of int
        Those in which a tracker follows each of several predictions; see `rootmatch.tracking.followed_places`.
    lit : (n,) array or float
        Probability that each point of a body in a predicted pose is lit, by the frames before.
    placed : (m,) bool array, optional
        Whether each point has been seen in its place on the body by the frames before.
    """

    predictions: Sequence[Mixed]
    log_shares: Sequence[float]
    without: Mixed
    doubt: float
    places: Sequence[int] = ()
    lit: Floats | float = 1.0
    placed: Bools | None = None

    @once
    def told(self) -> dict[str, Any]:
        """What was worked out of the predicted poses of a body, by its name: a frame asks several times."""
        return {}

    @once
    def minimum(self) -> int:
        """See `PoseDensity`: one match is one coincidence, which a clutter point that stands still repeats."""
        return 2 if self._gaussian_indices else 3

    @once
    def _gaussian_indices(self) -> list[int]:
        """Which of the predictions are normal in all six parameters."""
        return [k for k, one in enumerate(self.predictions) if isinstance(one, Gaussian)]

    def prediction_indices(self, rotation: Floats, position: Floats) -> Integers:
        """The prediction (K,) of the highest density at each of some poses; −1 if that without them is higher."""
        every, which = self._components(rotation, position)
        if len(self._gaussian_indices) == len(self.predictions) and every.squared.shape[1] == 1:
            return np.where(which < len(self._gaussian_indices), which, -1)
        of_first, of_others = self._component_predictions
        component = largest_component(every)
        return np.where(component == 0, of_first[which], of_others[component])

    @once
    def _component_predictions(self) -> tuple[Integers, Integers]:
        """Which prediction the first component is, −1 for none, by that of kernels, and each of the components."""
        known = [k for k, one in enumerate(self.predictions) if not isinstance(one, Gaussian)]
        others = np.full(1 + len(self.for_kernels[2][-1]), -1)
        others[1 : 1 + len(known)] = known
        return np.append(self._gaussian_indices, -1), others

    @once
    def for_kernels(self) -> Mixture:
        """See `PoseDensity.for_kernels`."""
        log_doubt, every = math.log(self.doubt), list[Knowledge]()
        normal, others = list[tuple[Gaussian, float]](), list[tuple[Mixed, float]]()
        for one, share in zip(self.predictions, self.log_shares, strict=True):
            if isinstance(one, Gaussian):
                normal.append((one, share))
            else:
                others.append((one, share))
        for one, share in [*others, (self.without, log_doubt)]:
            rotations, directions, places, peaks = one.for_kernels[2]
            if len(peaks):
                every.append((rotations, directions, places, peaks + share))
        any_turn, field, depth, log_share, radius = self.without.for_kernels[1]
        broad = any_turn, field, depth, log_share + log_doubt, radius
        return pack_predictions(normal, radius), broad, _concatenate_knowledge(every) if every else NO_KNOWLEDGE


@lru_cache(maxsize=16)
def _log_mass(freedom: float) -> float:
    """Logarithm of the integral of e^(−d²/2) over six parameters with the tails of `Gaussian`, over that without."""
    if math.isinf(freedom):
        return 0.0
    half, inner, outer = 0.5 * freedom, freedom / (freedom + 6.0), 6.0 / (freedom + 6.0)
    within = 1.0 - 8.5 * math.exp(-3.0)  # of χ² with six degrees of freedom
    tail = (half * half + half**3 * outer + 0.5 * half**3 * (half + 1.0) * outer**2) / ((half + 1.0) * (half + 2.0))
    return math.log(within + tail * math.exp(-3.0) / inner**3)


def pack_predictions(predictions: Sequence[tuple[Gaussian, float]], radius: float) -> tuple[Floats, ...]:
    """Predictions of a body, of a ``radius`` as of `Broad`, with their shares as arrays for the kernel."""
    if not predictions:
        return NO_PREDICTIONS
    return (
        np.array([one.rotation for one, _ in predictions]),
        np.array([one.position for one, _ in predictions]),
        np.array([one.bounded_covariance for one, _ in predictions]),
        np.array([one.log_gain(radius) + share - _log_mass(one.freedom) - LOG_PEAK for one, share in predictions]),
        np.array([one.freedom for one, _ in predictions], dtype=float),
    )


def _concatenate_knowledge(every: Sequence[Knowledge]) -> Knowledge:
    """Several pieces of knowledge."""
    *parts, peaks = zip(*every, strict=True)
    joined = (tuple(map(np.concatenate, zip(*part, strict=True))) for part in parts)
    return *joined, np.concatenate(peaks)  # type: ignore[return-value]


NO_PREDICTIONS = np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 6, 6)), np.empty(0), np.empty(0)
_NO_3, _NO_33 = np.empty((0, 3)), np.empty((0, 3, 3))
NO_KNOWLEDGE: Knowledge = (_NO_33, _NO_33), (_NO_3, _NO_3, np.empty(0)), (_NO_3, _NO_33, _NO_3), np.empty(0)

"""The density of clutter about each detection of an image, estimated from that image alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers, cache_by_values
from rootmatch.deadline import checkpoint
from rootmatch.frozen import once
from rootmatch.model.compiled.crowds import fill_given_densities, fill_log_of_taken, fill_place_densities, fit_crowds

FEW = 3
"""Smallest number of detections that determine the area of their image: fewer span none. By construction."""
SCALES = 6
"""Widths of crowds, each half as wide as the one before; the first is a quarter of the image. A round value."""
PSEUDO = 1.0
"""Pseudo-count of the uniform share of the mixture; all crowds together have as many in an image."""
PSEUDO_IN_SPACE = 0.1
"""The same of all crowds together between point sets: most have none, or crowds of one width. With 1, that one in 200
markers has a ghost, a marker 5 σ away was none in 10 of 300 sets of fiducials; .25 to .03 all do. A round value."""
MAXIMUM = 256
"""Largest number of detections about which others may crowd, drawn at random if there are more. A round value; it
bounds time and memory."""
PIECE = 100_000
"""Densities that are worked out between two looks at the deadline, 2 ms. A round value."""
STEPS = 30
"""Steps of expectation and maximisation. The shares hardly change after ten."""
WHOLE = 3.0
"""σ of the detections within which an extent is no smaller than the noise makes it. A round value."""


def clutter_areas(target: Floats, sigma: Floats, images: Sequence[Integers] = (), focal: float = 1.0) -> Floats:
    """Area (C,) that clutter fills in each image, in px², estimated from the detections.

    It is the area of their bounding box, corrected for the bias that uniform detections would have.

    Parameters
    ----------
    target, sigma : (n', 2) and (n',) arrays
        Detections with their σ.
    images : sequence of int arrays
        Which of them lie in each of several images; an image with too few detections gets the mean area of the others.
    focal : float
        Mean focal length, whose square is the area of each image if all have too few: that of an image 50° wide.
    """
    if not images:
        if len(target) == 0:
            return np.array([focal**2])
        extent = np.maximum(target.max(axis=0) - target.min(axis=0), 2.0 * WHOLE * float(sigma.max()))
        count = len(target)
        return np.array([float(extent[0] * extent[1]) * ((count + 1.0) / max(count - 1.0, 0.5)) ** 2])
    known = [float(clutter_areas(target[own], sigma[own])[0]) if len(own) >= FEW else math.nan for own in images]
    other = float(np.nanmean(known)) if np.isfinite(known).any() else focal**2
    return np.where(np.isfinite(known), known, other)


@dataclass(frozen=True, eq=False)
class Clutter:
    """The distribution of clutter in an image: uniform, or in crowds about other detections.

    A kernel estimate: a clutter point lies anywhere in the image, or about another detection with one of several
    widths. The shares of these are the most probable ones, with each detection predicted from all others. Detections of
    a body crowd too, so crowding as such is no evidence for a pose.

    Attributes
    ----------
    about : (n', c) float64
        Density per px² at each detection of a member of a crowd about each centre; zero about itself.
    centres : (c,) int64
        Detections about which others may crowd: all, or `MAXIMUM` of them.
    uniform : (n',) float64
        Density per px² of a point that lies anywhere in the image of each detection.
    alone : float
        Share of those.
    target, sigma : (n', k) and (n',) float64
        The detections.
    shares : (S,) float64
        Of crowds, by width.
    widths : (S, k) float64
        Standard deviations of crowds along each axis.
    repeats : float
        Share of those that repeat others, see `rootmatch.model.repetition`.
    repeating : (n',) float64, optional
        Probability that each detection, as clutter, is one of these.
    """

    about: Floats
    centres: Integers
    uniform: Floats
    alone: float
    target: Floats
    sigma: Floats
    shares: Floats
    widths: Floats
    repeats: float = 0.0
    repeating: Floats | None = None

    @once
    def log_density(self) -> Floats:
        """Logarithm (n',) of the density of a clutter point at each detection, given all others."""
        others = self.about.sum(axis=1) / max(len(self.centres) - 1, 1)
        return np.asarray(np.log(self.alone * self.uniform + others))

    @property
    def crowd_share(self) -> float:
        """Share of those in crowds."""
        return float(self.shares.sum())

    @property
    def for_kernels(self) -> tuple[Floats, Floats, Integers, Floats, float]:
        """As `rootmatch.model.compiled.evidence.weigh` takes it."""
        return self.log_density, self.about, self.centres, self.uniform, self.alone

    def density_about_places(self, places: Floats, variance: Floats, chance: Floats) -> Floats:
        """Density (K, n'), in parts of each detection's own, of crowds about places (K, n, k) with a variance (K, n).

        Each place has a crowd with some chance (K, n).
        """
        density = np.empty((len(places), len(self.target)))
        given = (np.ascontiguousarray(one, np.float64) for one in (places, variance, chance))
        fill_place_densities(self.target, self.sigma, *given, self.widths, self.shares, density)
        return density * self._relative_member_density

    @once
    def _relative_member_density(self) -> Floats:
        """What one member of a crowd is (n',) in parts of each detection's density."""
        return np.asarray(np.exp(-self.log_density) / max(len(self.centres) - 1, 1))

    def log_density_of_taken(self, taken: Bools, more: Floats) -> Floats:
        """Logarithm (K,) of the density of detections (K, n') that are taken, as clutter, given all that is left.

        What is left may crowd about what is taken, and has ``more`` (K, n') density, in parts of its own, about places
        where nothing was detected. Each clutter point lies anywhere or crowds about another one, and none about its own
        followers. The sum over all such forests is a determinant.
        """
        out, centres = np.empty(len(taken)), self.centres
        # columns that are picked lie in another order, which is another type to a kernel
        own, beyond = np.ascontiguousarray(taken[:, centres]), np.ascontiguousarray(more[:, centres])
        fill_log_of_taken(own, beyond, self._forest_inverse, self.log_density[centres], out)
        if len(centres) == len(self.target):
            return out
        # nothing crowds about the others
        whole = np.where(taken, self.log_density, -np.log1p(more))
        whole[:, centres] = 0.0
        return np.asarray(out + whole.sum(axis=1))

    def log_density_of_each(self, taken: Bools, more: Floats) -> Floats:
        """Logarithm (n',) of the density of each detection, as clutter, given that some (n',) are taken already.

        Of one that is taken: given that the others are. ``more`` (n',): see `log_density_of_taken`; of what is taken
        as well.
        """
        each, out = 1.0 + more, np.empty(len(self.centres))
        fill_given_densities(taken[self.centres], more[self.centres], self._forest_inverse, out)
        each[self.centres] = out
        return np.asarray(self.log_density + np.log(each))

    @property
    def log_density_of_all(self) -> Floats:
        """Logarithm (n',) of the density of each detection, as clutter, if all others are."""
        return self.log_density_of_each(np.zeros(len(self.target), np.bool_), np.zeros(len(self.target)))

    @once
    def _forest_inverse(self) -> Floats:
        """Inverse (c, c) of the matrix whose determinant is the sum over forests, in units of `log_density`."""
        scale = np.exp(-0.5 * self.log_density[self.centres])
        about = scale[:, None] * self.about[self.centres] * scale / max(len(self.centres) - 1, 1)
        return np.asarray(np.linalg.inv(np.eye(len(self.centres)) - about))


@cache_by_values(8, frozen=False)
def estimate_clutter(target: Floats, sigma: Floats, areas: Floats, image_of: Integers | None = None) -> Clutter:
    """The clutter of an image, computed once for all bodies and searches in it.

    Parameters
    ----------
    target, sigma : (n', 2) and (n',) arrays
    areas : (C,) array
        Of `clutter_areas`.
    image_of : (n',) int array, optional
        Image of each detection: they crowd within an image. One by default.
    """
    label = np.zeros(len(target), np.int64) if image_of is None else image_of
    side = math.sqrt(areas.sum() / len(areas))
    return _fit_clutter(target, sigma, 1.0 / areas[label], np.array([side, side]), label, crowds=PSEUDO)


@cache_by_values(8, frozen=False)
def estimate_space_clutter(target: Floats, sigma: Floats, extents: Floats) -> Clutter:
    """The clutter among targets of a plane or of space, which fills a box.

    ``target`` (n', k): along the axes of the box, whose ``extents`` are (k,); ``sigma`` (n',).
    """
    uniform, label = np.full(len(target), 1.0 / np.prod(extents)), np.zeros(len(target), np.int64)
    return _fit_clutter(target, sigma, uniform, extents, label, crowds=PSEUDO_IN_SPACE)


def _fit_clutter(
    target: Floats, sigma: Floats, uniform: Floats, extents: Floats, label: Integers, *, crowds: float
) -> Clutter:
    """Clutter by detections, σ, densities of the uniform part, and extents that clutter fills.

    ``label``: the image of each detection; ``crowds``: pseudo-count of all of them together.
    """
    count = len(target)
    if count < FEW:
        return Clutter(
            np.zeros((count, count)), np.arange(count), uniform.copy(), 1.0,
            target=target.copy(), sigma=sigma.copy(), shares=np.zeros(0), widths=np.empty((0, len(extents))),
        )  # fmt: skip
    centres = np.arange(count)
    if count > MAXIMUM:
        centres = np.sort(np.random.default_rng(0).choice(count, MAXIMUM, replace=False))
    about, widths, shares = np.empty((count, len(centres))), np.empty((SCALES, len(extents))), np.empty(SCALES + 1)
    # copies: what is read-only is another type to a kernel
    target, sigma, uniform = target.copy(), sigma.copy(), uniform.copy()
    detections, limits = (target, sigma, uniform, label.copy()), (PSEUDO, crowds / SCALES, STEPS)
    out = about, widths, shares, np.empty((SCALES, *about.shape)), np.empty((SCALES + 1, count))
    step = max(PIECE // (SCALES * len(centres)), 1)
    for first in range(0, count, step):
        checkpoint()
        fit_crowds(detections, centres, extents.copy(), limits, (first, min(first + step, count)), out)
    return Clutter(
        about, centres, uniform, float(shares[0]), target=target, sigma=sigma, shares=shares[1:], widths=widths
    )

"""The box that targets span, in which clutter lies: its volume, its edges, and the axes along which it is taken."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, cache_by_values
from rootmatch.model.clutter import Clutter, estimate_space_clutter

_HALF, WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Nodes of the integral over a box, which is then off by less than .01 in its logarithm, and weights."""
_LOG_NODES = np.log(0.5 + 0.5 * _HALF)


INSIDE = 0.5
"""Prior probability that, if the object is among the targets, all of it is within the box that clutter fills, and not
its middle alone. A round value."""
IN_PART = 0.2
"""Prior probability that the targets show neither, but what of the object is in a window. A round value."""

UNTOLD = np.zeros(1)
"""Of a motion of which nothing is known."""


class Placement(NamedTuple):
    """How much more probable K motions are by where an object may be, than with its middle anywhere among the targets.

    The box of clutter has an unknown place, and unknown edges L with the density L⁻². Targets span r, with all points
    of the object r', and these alone l. With c points that may be anywhere in the box, its translation has the density
    1 / (L − l) in the place of 1 / L, and each edge the factor

        (c + 1) (c + 2) r^(c + 1) ∫ (L − r') L^(−c − 2) / (L − l) dL,  L > r'.

    If its scale is unknown, the object has any size up to that of the box: s is flat, and not its logarithm.

    Or targets are what a window shows, which is where they are. Points that are not in view are not missed: δ is that
    of the others. The object may be wherever it and the window overlap.
    """

    inside: Floats
    """(K, k) of each axis if it is wholly in the box, as logarithms, and the same of the scale."""
    missed: Floats | None
    """(K,) of the points in view of a window; None if all are."""
    overlap: Floats
    """(K, k) of where the window is."""

    def log_factors(self, log_rates: Floats, told: Floats = UNTOLD) -> Floats:
        """Logarithm (K,) of all of these, averaged, by what rates tell (K,) without a window.

        ``told`` (…, k + 1): how well places along each axis, and the scale, are known, see `MotionPrior.tell_places`.
        """
        inside = _sum_untold(self.inside, told)
        placed = np.logaddexp(math.log(INSIDE) + inside, math.log1p(-INSIDE)) + log_rates
        if self.missed is None:
            return np.asarray(placed)
        in_part = self.missed + _sum_untold(self.overlap, told)
        return np.asarray(np.logaddexp(math.log1p(-IN_PART) + placed, math.log(IN_PART) + in_part))


def _sum_untold(log: Floats, told: Floats) -> Floats:
    """Sum (K,) of logarithms of densities along axes (K, k), as far as nothing else tells the places."""
    share = told[..., : log.shape[1]]
    with np.errstate(divide="ignore"):
        return np.asarray((log + 0.5 * np.logaddexp(np.log(share) - 2.0 * log, np.log1p(-share))).sum(axis=1))


@cache_by_values(8)
def fit_clutter_space(target: Floats, variance: Floats) -> tuple[Floats, Clutter, Floats, Floats]:
    """Extents (k,) of the box that targets span, the clutter in it, once for all bodies among them, and its frame."""
    middle, axes, along, extents = bounding_box(target, variance)
    return extents, estimate_space_clutter(along, np.sqrt(variance), extents), middle, axes


@cache_by_values(8)
def box_edges(target: Floats, variance: Floats, count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Corners of the box that targets span, how many may be anywhere by how many are matched, and 1 − r' / L at nodes.

    Those of Gauss and Legendre in (r' / L)^(c + 1).
    """
    clutter, own = fit_clutter_space(target, variance)[1], _noise_thickness(variance)
    low, high = clutter.target.min(axis=0), clutter.target.max(axis=0)
    thin = np.maximum(own - (high - low), 0.0)
    left = clutter.alone * np.maximum(len(clutter.target) - np.arange(count + 1.0), 0.0)
    return low - 0.5 * thin, high + 0.5 * thin, left, -np.expm1(_LOG_NODES / (left[:, None] + 1.0))


def bounding_box(points: Floats, variance: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Mean and principal axes of points (n, k), these along them, and extents (k,) of the box that they fill.

    Corrected for n uniform ones. Whatever the axes of the frame, points of a plane span a thin box; it is as thick as
    the noise.
    """
    middle = points.mean(axis=0)
    centred = points - middle
    axes = np.linalg.eigh(centred.T @ centred)[1]
    along = centred @ axes
    extent = np.ptp(along, axis=0) * ((len(points) + 1) / max(len(points) - 1, 1))
    return middle, axes, along, np.asarray(np.maximum(extent, _noise_thickness(variance)))


def view_probability(along: Floats, low: Floats, high: Floats, count: int) -> Floats:
    """Probability (…,) that places (…, k) are in the view that ``count`` points show, which span ``low`` to ``high``.

    It ends where no point is seen any more: a place e beyond them is in view with (r / (r + e))^(count − 1) along an
    axis, as the points span r.
    """
    span, off = high - low, np.maximum(np.maximum(low - along, along - high), 0.0)
    return np.asarray((span / (span + off)).prod(axis=-1) ** (count - 1))


def view_probability_among(places: Floats, points: Floats, variance: Floats) -> Floats:
    """The same of places (…, k) and of the points (n, k) themselves; what these span is as thick as the noise."""
    middle, axes, own, span = bounding_box(points, variance)
    centre = 0.5 * (own.min(axis=0) + own.max(axis=0))
    return view_probability((places - middle) @ axes, centre - 0.5 * span, centre + 0.5 * span, len(points))


def _noise_thickness(variance: Floats) -> float:
    """Of the box that points fill whose spread is that of noise."""
    return 2.0 * math.sqrt(2.0 * math.pi * float(variance.max()))

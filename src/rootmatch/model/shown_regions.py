"""Regions of an object of which targets show more, or less, than of the rest: what a scan has about its place.

With one detection rate for all points, those beyond the region that a scan covers make it low: each point in it is then
as probably missed, and a match there little better than a stray that lies near its place. So either all points have one
rate, or those about a place and the others have one each: so many points nearest to one of them. The search looks for
such parts as well, see `rootmatch.samplers.point_sets.shown_parts`.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers, cache_by_values
from rootmatch.problems.points import pairwise_squared_distances
from rootmatch.problems.pose_fit.point_set_fit import FEWEST

BY_REGION = 0.2
"""Prior probability that a region and the rest have a rate each, as of a window. A round value."""
PLACES = 64
"""Largest number of places about which regions are, drawn at random if there are more. A round value."""
LARGER = 1.2
"""Factor from one number of points of a region to the next one; each is as probable. A round value: with twice as many
points at each step, the rims of regions are too far from where they are."""


def log_detection_count(n: int, matched: Integers, rate: float | None = None) -> Floats:
    """Logarithm of the chance that so many certain ones of n points have a target, at one rate, flat if unknown."""
    from scipy.special import betaln  # slow to import

    if rate is None:
        return np.asarray(betaln(matched + 1.0, n - matched + 1.0))
    return np.asarray(matched * math.log(rate) + (n - matched) * math.log1p(-rate))


def log_region_factor(source: Floats, matched: Bools, rate: float | None = None) -> Floats:
    """Logarithm (K,) of how much more probable it is with regions that these of the points have a target.

    All rates are integrated under flat priors.

    Parameters
    ----------
    source : (n, k) array
    matched : (K, n) bool array
        Which points have a target.
    rate : float, optional
        Of all points, if it is known: no region has another.
    """
    regions, log_rest, log_factorial = _list_regions(source)
    if rate is not None or not len(regions):
        return np.zeros(len(matched))
    n, every = len(source), matched.sum(axis=1)
    with np.errstate(invalid="ignore"):  # BLAS may set the flag for what it pads small matrices with
        inside = (matched.astype(np.float32) @ regions.T).astype(np.int64)
    size = regions.sum(axis=1).astype(np.int64)
    outside = every[:, None] - inside
    counts = inside, size - inside, outside, n - size - outside
    odds = sum((log_factorial[one] for one in counts), log_rest)
    top = odds.max(axis=1)
    more = top + np.log(np.exp(odds - top[:, None]).mean(axis=1)) - log_factorial[every] - log_factorial[n - every]
    return np.asarray(np.logaddexp(math.log1p(-BY_REGION), math.log(BY_REGION) + more))


@cache_by_values(8)
def _list_regions(source: Floats) -> tuple[Floats, Floats, Floats]:
    """Which points (R, n) are in each region, as numbers.

    And log (n + 1)! / ((s + 1)! (n − s + 1)!), (R,), with s points in it, and log k! up to k = n + 1.
    """
    from scipy.special import gammaln  # slow to import

    n = len(source)
    steps = max(math.ceil(math.log(max(n, 1) / FEWEST) / math.log(LARGER)), 0)
    sizes = np.unique(np.round(FEWEST * LARGER ** np.arange(steps)).astype(np.int64))
    sizes = sizes[sizes < n]
    about = np.sort(np.random.default_rng(0).permutation(n)[:PLACES])
    place = pairwise_squared_distances(source[None, about], source)[0].argsort(axis=1, kind="stable").argsort(axis=1)
    inside = (place < sizes[:, None, None]).reshape(-1, n).astype(np.float32)
    log_factorial = gammaln(np.arange(n + 2.0) + 1.0)
    own = np.repeat(log_factorial[n + 1] - log_factorial[sizes + 1] - log_factorial[n - sizes + 1], len(about))
    return inside, own, log_factorial

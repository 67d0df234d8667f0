"""Priors that the models of an image, of two views and of point sets share."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from rootmatch.arrays import Floats


def probability(log_odds: float) -> float:
    """Probability of what has such log-odds."""
    return 1.0 / (1.0 + math.exp(min(-log_odds, 700.0)))


def log_chance(chance: Floats) -> Floats:
    """Logarithms of probabilities, finite where these are 0."""
    return np.asarray(np.log(np.maximum(chance, 1e-300)))


PRESENT_ODDS = math.log(0.8) - math.log1p(-0.8)
"""Logarithm of the prior odds that the image shows the body, given that somebody asks for it: a probability of 0.8."""
IN_VIEW = probability(PRESENT_ODDS)
"""The same as a probability."""
PRESENT = 0.5
"""Probability that two images, or two point sets, show the same points, before they are seen; that of a body in an
image is `IN_VIEW`. A round value."""
DEPTHS = 100.0
"""Ratio of the largest to the smallest distance of a body, and of the limit up to which a detector sees it, each octave
equally probable. A round value; ten times as much is 0.4 in the logarithm of the odds."""
COPY = 1e-3
"""Prior odds that the image shows another copy of the body, which nobody named. A stated value, not measured."""
ALIKE = 1e-3
"""Odds that images, or point sets, show what is alike and not the same, over those that they have nothing in common. As
of a copy, which nobody named: a stated value, not measured."""
COUNTS = 3.0
"""Log-odds against a copy of the body at which its place still counts: with a twentieth, a probability changes by half
of that."""
NOISE_FREEDOM = 20.0
"""Number of residuals that the stated σ is worth as evidence of its own scale, whose square is inverse gamma: it is
known to a sixth. A round value."""
INEXACT = 0.05
"""Probability that the points of a body are off though no noise of them was stated. A stated value."""
WRONG_MODEL = 1e-3
"""Probability that the model does not hold at all (another body, a wrong calibration): no result is more certain than
that. A stated floor, not measured."""
RATE_NODES = 10
"""Nodes of the quadrature over the rate, exact for twice as many points."""


@lru_cache(maxsize=16)
def beta_quadrature(first: float, second: float) -> tuple[Floats, Floats]:
    """Nodes in (0, 1) and logarithms of weights of the mean under Beta(first, second), by Gauss and Jacobi."""
    from scipy.special import roots_jacobi  # slow to import

    places, weights = roots_jacobi(RATE_NODES, second - 1.0, first - 1.0)
    places, weights = 0.5 * (1.0 + places), np.log(weights / weights.sum())
    return places, weights

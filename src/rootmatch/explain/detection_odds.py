"""Odds of correspondences before anything is seen."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Bools, Floats


def candidate_log_odds(weights: Floats, among: Bools | None = None) -> Floats:
    """Logarithms (n, n') of the weights of candidates over their mean in each row; −∞ where one is zero.

    A row tells which of its candidates is the detection of a point, if it has one: the weight of each over their sum
    stands in the place of one over their number. So only ratios within a row count, as those of likelihoods do. The
    factor of a clutter point is 1 in the mean: weights that know nothing make no pose more probable than clutter.

    ``among``: (n, n') which pairs may be, of a rig those of a sighting's own camera.
    """
    possible = weights > 0.0 if among is None else among & (weights > 0.0)
    mean = np.where(possible, weights, 0.0).sum(axis=1) / np.maximum(possible.sum(axis=1), 1)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(weights) - np.log(np.where(mean > 0.0, mean, 1.0))[:, None])

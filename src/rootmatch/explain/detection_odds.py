"""Odds of correspondences before anything is seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.task import MatchingTask


def candidate_log_odds(task: MatchingTask) -> NDArray[np.float64]:
    """Logarithms (n, n') of the weights of candidates over the largest; zero where none are given."""
    if task.weights is None:
        return np.zeros(task.shape)
    with np.errstate(divide="ignore"):
        logarithms = np.log(task.weights)
        return np.asarray(logarithms - logarithms.max(initial=-math.inf))

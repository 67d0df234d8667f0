"""By how much what is observed widens a prediction, whose covariance is an estimate and may be too small.

The covariance is that of a prediction times a factor, with the inverse gamma prior of an estimate from `FREEDOM`
samples: so deviations have the tails of a t-distribution. The factor is the most probable one with the pose integrated
out, and never below 1: see `rootmatch.model.pose_density.Gaussian`.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Floats

FREEDOM = 8.0
"""Degrees of freedom of the covariance of a pose that a tracker predicts, which may be too small. Of 822 bodies in
three flights of a rig 790 were right with a normal distribution, 816 with 4 and 822 with 8 (benchmarks/flights.py, rig,
seeds from 1000)."""
STEPS = 30
"""Largest number of steps of `find_widening`, each of which leaves less than half of the error. A round value."""
PRECISE = 1e-3
"""Relative change of a factor at which it is found. A round value."""


def find_widening(off: Floats, predicted: Floats, observed: Floats, freedom: float) -> float:
    """The factor on the covariance (p, p) of a prediction, from which an observation of another one is ``off`` (p,)."""
    if math.isinf(freedom):
        return 1.0
    total = predicted + observed
    unit = np.sqrt(total.diagonal())  # turns and shifts have different units
    values, axes = np.linalg.eigh(total / (unit[:, None] * unit))
    root = axes / np.sqrt(np.maximum(values, values[-1] * np.finfo(float).eps)) / unit[:, None]
    part, axes = np.linalg.eigh(root.T @ predicted @ root)
    part, squared, factor = np.clip(part, 0.0, 1.0), (off @ root @ axes) ** 2, 1.0
    for _ in range(STEPS):
        share = factor / (factor * part + 1.0 - part)
        # of the pose's mean from the prediction, and what is left open about that
        before, mean = factor, share * share @ (part * squared) + share @ (1.0 - part)
        factor = max((freedom + float(mean)) / (freedom + len(off)), 1.0)
        if factor - before < PRECISE * factor:
            break
    return factor

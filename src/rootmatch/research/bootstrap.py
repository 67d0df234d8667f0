"""Means over instances and how sure they are: percentile bootstrap over the instances."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Floats

RESAMPLES = 2000
CONFIDENCE = 0.95
_SEED = 20_240_229  # of the resampling; fixed, so that the same rows give the same bands


@dataclass(frozen=True)
class Estimate:
    """A mean with the ends of its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float
    count: int


def bootstrap_means(values: ArrayLike, seed: int = _SEED) -> Floats:
    """Means (RESAMPLES, …) of resampled instances; values (instances, …), the same resampling for all columns."""
    array = np.asarray(values, dtype=np.float64)
    means: Floats = np.tensordot(_shares(len(array), seed), array, axes=1)
    return means


@lru_cache(maxsize=4)
def _shares(count: int, seed: int) -> Floats:
    """Share of each instance in each resampling, (RESAMPLES, count)."""
    draws = np.random.default_rng(seed).multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)
    return np.asarray(draws / count)


def _interval(means: Floats) -> Floats:
    """Ends (2, …) of the interval of resampled means (RESAMPLES, …)."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    ends: Floats = np.percentile(means, (tail, 100.0 - tail), axis=0)
    return ends


def estimates(values: ArrayLike) -> list[Estimate]:
    """One estimate for each column of values (instances, columns)."""
    array = np.asarray(values, dtype=np.float64)
    low, high = _interval(bootstrap_means(array))
    return [
        Estimate(float(m), float(a), float(b), len(array))
        for m, a, b in zip(array.mean(axis=0), low, high, strict=True)
    ]


def estimate(values: ArrayLike) -> Estimate:
    """Mean of values (instances,) and its interval."""
    return estimates(np.asarray(values, dtype=np.float64)[:, None])[0]


def difference(first: ArrayLike, second: ArrayLike) -> Estimate:
    """Mean of first − second of two independent groups of instances, each resampled on its own.

    For paired instances take `estimate` of the differences.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    means = bootstrap_means(a) - bootstrap_means(b, _SEED + 1)
    low, high = _interval(means)
    return Estimate(float(a.mean() - b.mean()), float(low), float(high), min(len(a), len(b)))

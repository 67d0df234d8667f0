"""Density of detections in an image, or in the images of a rig, some of which may hold only one or two."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rootmatch.model.clutter import FEW
from rootmatch.samplers.guided.detection_grid import local_density

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def crowded_density(target: Floats, sigma: float, area: float, images: Sequence[Integers] = ()) -> Floats:
    """Density (n',) per pixel² of detections about each, within its own image; the mean one where that holds few."""
    if not images:
        return local_density(target.T, sigma) if len(target) > 1 else np.full(1, 1.0 / area)
    density = np.full(len(target), len(target) / area)
    for own in images:
        if len(own) >= FEW:
            density[own] = local_density(np.ascontiguousarray(target[own].T), sigma)
    return density


def normal_density(target: Floats, variance: Floats, pixels: Floats, spread: Floats) -> Floats:
    """Density per pixel² (…, n, n') of detections (n', 2) about predictions (…, n, 2) with covariances (…, n, 2, 2)."""
    squared, determinant = squared_deviations(target, variance, pixels, spread)
    return np.asarray(np.exp(-0.5 * squared) / (2.0 * math.pi * np.sqrt(determinant)))


def squared_deviations(target: Floats, variance: Floats, pixels: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """χ² and determinant of spread + variance · 1, in terms that are none of them negative.

    The determinant of a spread of rank one, far wider than the variance, is pure rounding error of either sign.
    """
    x = target[:, 0] - pixels[..., 0, None]
    y = target[:, 1] - pixels[..., 1, None]
    a, c = np.maximum(spread[..., 0, 0, None], 0.0), np.maximum(spread[..., 1, 1, None], 0.0)
    b = spread[..., 0, 1, None]
    determinant = np.maximum(a * c - b * b, 0.0) + variance * (a + c + variance)
    x2, y2 = x * x, y * y
    across = np.maximum(c * x2 - 2.0 * b * (x * y) + a * y2, 0.0)
    return (across + variance * (x2 + y2)) / determinant, determinant

"""How dense detections lie in an image, or in those of a rig, each of which may hold but one or two of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rootmatch.samplers.guided.detection_grid import local_density

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FEW = 3
"""Detections from which an image of a rig tells its own density: fewer span no area. By construction."""


def clutter_area(target: Floats, sigma: Floats, images: Sequence[Integers] = (), focal: float = 1.0) -> float:
    """Area that clutter fills, as n' uniform points tell it: their bounding box, corrected for being too small.

    Parameters
    ----------
    target, sigma : (n', 2) and (n',) arrays
        Detections with their σ.
    images : sequence of int arrays
        Which of them lie in each of several images; what holds too few is as large as the others are in the mean.
    focal : float
        Mean focal length, whose square is the area of such an image where all hold too few: it is 50° wide.
    """
    if not images:
        extent = np.maximum(np.ptp(target, axis=0), 8.0 * float(sigma.max()))
        count = len(target)
        return float(np.prod(extent)) * ((count + 1.0) / max(count - 1.0, 0.5)) ** 2
    known = [clutter_area(target[own], sigma[own]) for own in images if len(own) >= FEW]
    other = float(np.mean(known)) if known else focal**2
    return sum(known) + other * sum(0 < len(own) < FEW for own in images)


def crowded_density(target: Floats, sigma: float, area: float, images: Sequence[Integers] = ()) -> Floats:
    """Density (n',) per pixel² of detections about each, within its own image; the mean one where that holds few."""
    if not images:
        return local_density(target.T, sigma) if len(target) > 1 else np.full(1, 1.0 / area)
    density = np.full(len(target), len(target) / area)
    for own in images:
        if len(own) >= FEW:
            density[own] = local_density(np.ascontiguousarray(target[own].T), sigma)
    return density

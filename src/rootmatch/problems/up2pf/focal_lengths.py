"""What is known of a focal length before an image is seen, and the grid of them at which poses are searched."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats

USUAL_FOCAL, ZOOM = 1.2, 1.0
"""Focal length over the width of the image that half of all cameras exceed: 45° across. And standard deviation of its
logarithm: 95 % are between 7° and 143° across, which covers what lenses have. Round values; a deviation of 2 in the
place of 1 lowers log-odds by .7 at most."""
MAX_LOG = 3.0
"""Largest logarithm of a focal length over the usual one: beyond 2° across an image tells no focal length."""
REACH, STEP = 2.25, 0.15
"""Logarithm of the focal lengths over the usual one up to which poses are searched, which is so for 98 % of cameras,
and its steps. Half a step displaces a detection by what `SLACK` allows. Round values."""
SLACK = 0.005
"""Noise that a search allows for, beside the given one, over the detections' distance from the principal point: the
nearest focal length of the grid is not the right one. With .005 searches a whole step beside the right focal length
name 8 to 12 of 12 points, with none 6 to 8 (four scenes of `benchmarks/zoom.py`, seeds from 1000)."""


def usual_focal(centre: Floats, target: Floats) -> float:
    """The focal length that half of all cameras exceed, in pixels.

    The image is taken to be twice as wide as the principal point is off its left or upper edge or, if detections
    (n', 2) lie outside of that, as they are off the principal point.
    """
    inside = ((target >= 0.0) & (target <= 2.0 * centre)).all()
    half = float(centre.max() if inside else np.abs(target - centre).max(initial=0.0))
    return USUAL_FOCAL * 2.0 * max(half, 1e-100)


def focal_grid(centre: Floats, target: Floats) -> Floats:
    """Focal lengths at which poses are searched."""
    steps = round(REACH / STEP)
    return np.asarray(usual_focal(centre, target) * np.exp(STEP * np.arange(-steps, steps + 1)))


def search_noise(centre: Floats, target: Floats, sigma: Floats) -> Floats:
    """σ (n',) of detections that allows for a focal length between two of the grid."""
    away = np.sqrt(((target - centre) ** 2).sum(axis=1).mean())
    return np.asarray(np.hypot(sigma, SLACK * away))

"""Noise of a model point that all of its sightings share: the covariance of what several images show of one point.

Sightings are ordered image by image, (…, C n): all points of the first image, then those of the second.
"""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats


def group_by_point(rows: Floats, images: int) -> Floats:
    """What sightings (…, C n, k, q) have, point by point: (…, n, C k, q)."""
    *some, count, k, q = rows.shape
    parts = rows.reshape(*some, images, count // images, k, q)
    return parts.swapaxes(-4, -3).reshape(*some, count // images, images * k, q)


def ungroup_sightings(rows: Floats, images: int) -> Floats:
    """The inverse of `by_points`."""
    *some, count, size, q = rows.shape
    parts = rows.reshape(*some, count, images, size // images, q)
    return parts.swapaxes(-4, -3).reshape(*some, images * count, size // images, q)


def shared_spread(by_point: Floats, covariance: Floats | None, own: Floats, images: int) -> Floats:
    """Covariances (…, n, C k, C k) of the sightings of each point: J Σ Jᵀ with the J of all of them, and their own.

    Parameters
    ----------
    by_point : (…, C n, k, 3) array
        Derivatives J of the sightings by their points; zero where a point is not matched.
    covariance : (…, C n, 3, 3) array or None
        Σ of the points, the same for all sightings of one; None if they are exact.
    own : (…, C n, k, k) array
        Covariances of the detections.
    images : int
        C.
    """
    rows, k = group_by_point(by_point, images), by_point.shape[-2]
    count, size = rows.shape[-3:-1]
    spread = np.zeros((*rows.shape[:-1], size))
    if covariance is not None:
        spread += rows @ covariance[..., :count, :, :] @ rows.swapaxes(-1, -2)
    for image in range(images):
        some = slice(image * k, (image + 1) * k)
        spread[..., some, some] += own[..., image * count : (image + 1) * count, :, :]
    return spread

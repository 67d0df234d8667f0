"""What the fits of poses share."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats


def regularise_normal(normal: Floats) -> Floats:
    """Normal equations (K, p, p), made solvable where a pose is not determined."""
    p = normal.shape[-1]
    whole = np.isfinite(normal.sum(axis=(1, 2), keepdims=True))
    normal = np.where(whole, normal, np.eye(p))
    diagonal = np.arange(p)
    normal[:, diagonal, diagonal] *= 1.0 + 1e-12
    normal[:, diagonal, diagonal] += 1e-300
    return normal

"""Tangents of directions, in plain Python and for NumPy: cameras need them where nothing else takes Numba."""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.algebra.rotation import cross
from rootmatch.arrays import Floats


def tangent_basis_at(x: Any, y: Any, z: Any) -> Any:
    """Two unit vectors orthogonal to a unit vector and to each other, without a branch (Duff et al. 2017).

    The three are right-handed in this order: first × second = (x, y, z). Plain Python, for a single vector;
    `tangent_basis` is the same as a kernel, `tangent_bases` serves arrays.
    """
    sign = 1.0 if z >= 0.0 else -1.0
    w = -1.0 / (sign + z)
    v = x * y * w
    return (1.0 + sign * x * x * w, sign * v, -sign * x), (v, sign + y * y * w, -y)


def tangent_bases(vectors: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (…, 3) orthogonal to unit vectors (…, 3) and to each other; right-handed like `tangent_basis`.

    Not the same vectors: these begin with the axis to which each vector is least aligned, which NumPy has as a lookup.
    """
    axis = np.eye(3)[np.abs(vectors).argmin(axis=-1)]
    first = cross(vectors, axis)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return first, cross(vectors, first)

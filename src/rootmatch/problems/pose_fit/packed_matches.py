"""The matches of several assignments in arrays as wide as the largest of them needs, in a common unit and origin."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.problems.points import PointSets


class PackedMatches(NamedTuple):
    """K assignments of at most m matches each, fewer with weights of 0."""

    centre: Floats
    """(3,) mean of all source points."""
    unit: float
    """Their root mean square distance from it, on each axis."""
    source: Integers
    """(K, m) source points."""
    target: Integers
    """(K, m) detections."""
    places: Floats
    """(K, m, 3) source points from the centre, in that unit."""
    weight: Floats
    """(K, m) inverse σ of the detections."""


def pack_matches(points: PointSets, assignments: Integers) -> PackedMatches:
    """Pack assignments (K, n), −1 where unmatched."""
    centre = points.source.mean(axis=0)
    unit = float(np.sqrt(((points.source - centre) ** 2).mean()))
    used = assignments >= 0
    most = int(used.sum(axis=1).max(initial=0))
    source = np.argsort(~used, axis=1, kind="stable")[:, :most]
    target = np.maximum(np.take_along_axis(assignments, source, axis=1), 0)
    weight = np.where(np.take_along_axis(used, source, axis=1), 1.0 / points.target_noise[target], 0.0)
    places = (points.source[source] - centre) / unit
    return PackedMatches(centre, unit, source=source, target=target, places=places, weight=weight)

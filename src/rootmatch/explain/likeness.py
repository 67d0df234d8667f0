"""Which points of one body correspond to those of another that is like it: a copy, a mirror image, or one of a family.

Bodies of a family share most of their points. Where one of them is, another one may be nearly as well, and no search
need have met that.
"""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats, Integers, kept_by_values
from rootmatch.explain.body_labels import SAME_SHAPE, twin_points
from rootmatch.problems.points import PointClouds, distances
from rootmatch.samplers.point_sets.congruent import GATE, congruent_labellings

LEAST, SHARE = 4, 0.5
"""Fewest points that bodies of a family share, as three look like any others, and the least share of the smaller one's.
A round value."""
MOST_POINTS = 16
"""Number of points beyond which a body is compared with its copies and mirror images alone: ten milliseconds."""


def likenesses(first: Floats, second: Floats) -> tuple[Integers, ...]:
    """For each way in which two bodies are alike, the point (n,) of the second for each of the first; −1 for none.

    Parameters
    ----------
    first, second : (n, 3) and (m, 3) arrays
        Their points. They are alike up to `SAME_SHAPE` times the size of the first.
    """
    twin = twin_points(first, second)
    if twin is not None:
        return (twin,)
    if max(len(first), len(second)) > MOST_POINTS:
        return ()
    return _likenesses(first, second)


@kept_by_values(256)
def _likenesses(first: Floats, second: Floats) -> tuple[Integers, ...]:
    """`likenesses` of bodies of a family."""
    # a distance agrees within GATE of the deviations of both of its ends
    variance = 0.5 * (SAME_SHAPE * float(distances(first).max()) / GATE) ** 2
    noise = np.full(len(first), variance), np.full(len(second), variance)
    clouds = PointClouds(first, second, *noise, scaled=False, mirror=False)
    least = max(LEAST, SHARE * min(len(first), len(second)))
    found = congruent_labellings(clouds, False)
    best = [*found.proper[:1], *found.mirrored[:1]]
    return tuple(one for one in best if np.count_nonzero(one >= 0) >= least)

"""Triangles of point sets of a plane by their signed sines, and the most alike of another set."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Floats, Integers

ORDERS = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)])
"""All orders of a triangle's points; the last three turn it over."""
SIGNS = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
"""Of the sines in each of them."""


def nearest_triangles(asked: Floats, sines: Floats, count: int) -> tuple[Integers, Integers, Floats]:
    """The triangles, in any order of their points, whose sines are nearest to each of those asked for.

    Parameters
    ----------
    asked : (S, 3) array
    sines : (T, 3) array
    count : int
        Neighbours of each, at most 6 T.

    Returns
    -------
    triangle, order : (S, count) arrays
        Row of ``sines`` and row of ``ORDERS``, in no particular order.
    distance : (S, count) array
    """
    from scipy.spatial import cKDTree  # slow to import

    tree, each = cKDTree(sines), min(count, len(sines))
    # a triangle in an order is as far from what is asked as it is, as it stands, from that in the inverse order
    found = [
        tree.query(sign * asked[:, np.argsort(order)], k=[*range(1, each + 1)])
        for order, sign in zip(ORDERS, SIGNS, strict=True)
    ]
    distance, triangle = (np.concatenate(part, axis=1) for part in zip(*found, strict=True))
    count = min(count, distance.shape[1])
    kept = np.argpartition(distance, count - 1, axis=1)[:, :count]
    triangle, distance = (np.take_along_axis(part, kept, axis=1) for part in (triangle, distance))
    return triangle, kept // each, distance

"""Labels of source points: which rigid body each belongs to, and which bodies look alike."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rootmatch.arrays import Floats, Integers, cache_by_identity, cache_by_values
from rootmatch.deadline import checkpoint
from rootmatch.errors import InputError
from rootmatch.frozen import copy_with
from rootmatch.hypergraph.assignment import SECONDS_PER_STEP
from rootmatch.problems.checks import find_repeated
from rootmatch.problems.points import OF_TARGET, PointSets, distances

Label = int | str
SAME_SHAPE = 0.02
"""Distance of their points, over their size, up to which two bodies are one shape or mirror images. A round value."""


@dataclass(frozen=True, eq=False)
class BodyLabels:
    """Validated labels."""

    names: tuple[Label, ...]
    """The labels, in the order in which they appear."""
    index: Integers
    """(n,) position in ``names`` of each source point's label."""

    def points_of(self, k: int) -> Integers:
        """Source points of one body, ascending."""
        return self._points[k]

    @cached_property
    def _points(self) -> list[Integers]:
        return [np.flatnonzero(self.index == k) for k in range(len(self.names))]

    def parts_of(self, points: PointSets) -> list[PointSets]:
        """The points of each body with all detections; of the same source the same arrays, frame after frame."""
        source = points.source, points.normals, points.view_cosine, points.source_covariance
        known: tuple[Any, list[PointSets]] | None = vars(self).get("_parts")
        if known is None or any(one is not other for one, other in zip(known[0], source, strict=True)):
            known = vars(self)["_parts"] = source, [points.subset(own) for own in self._points]
        target = {name: getattr(points, name) for name in OF_TARGET}
        every = zip(known[1], self._points, strict=True)
        return [copy_with(part, source_noise=points.source_noise[own], **target) for part, own in every]


def check_bodies(labels: Any, source: Floats, minimum: int) -> BodyLabels:
    """Labels of source points (n, k), at least ``minimum`` of which belong to each body.

    Refused are labels that are neither whole numbers nor strings, or not one for each point, too few points that share
    one, and two points of one body that are the same.
    """
    count = len(source)
    expected = f"give a whole number or a name for each of {count} source points"
    try:
        array = np.asarray(labels)
    except (TypeError, ValueError):
        raise InputError(f"bodies: not an array; {expected}") from None
    if array.dtype.kind == "O":
        kinds = {type(label) for label in array.ravel().tolist()}
        if kinds and kinds <= {str}:
            array = array.astype(np.str_)
    if array.dtype.kind not in "iuU":
        raise InputError(f"bodies: labels of type {array.dtype} given; {expected}")
    if array.shape != (count,):
        raise InputError(f"bodies: shape {array.shape} given; {expected}")
    unique, first, inverse = np.unique(array, return_index=True, return_inverse=True)
    order = np.argsort(first)
    names: tuple[Label, ...] = tuple(unique[order].tolist())
    index = np.argsort(order)[inverse].astype(np.int64)
    for k, name in enumerate(names):
        points = int((index == k).sum())
        if points < minimum:
            raise InputError(f"bodies: body {name!r} has {points} points; give it at least {minimum}")
        own = np.flatnonzero(index == k)
        same = find_repeated(source[own])
        if same is not None:
            i, j = own[list(same)]
            raise InputError(f"source: points {i} and {j} of body {name!r} are the same; remove repeated points")
    return BodyLabels(names, index)


@cache_by_identity(64)
@cache_by_values(64)
def twin_points(first: Floats, second: Floats) -> Integers | None:
    """Index (n,) of the point of the second body (n, 3) for each of the first, if they are congruent or mirror images.

    Points correspond by their sorted distances to all others, and equal distances confirm it. None for bodies of
    different shape: beyond `SAME_SHAPE` times the size of the first. Raises `OutOfTime` at the deadline in force.
    """
    if len(first) != len(second):
        return None
    one, two = distances(first), distances(second)
    maximum = SAME_SHAPE * float(one.max())
    if np.abs(np.sort(one, axis=None) - np.sort(two, axis=None)).max() > maximum:
        return None
    profiles, others = np.sort(one, axis=1), np.sort(two, axis=1)
    cost = np.empty(one.shape)
    for row, profile in zip(cost, profiles, strict=True):
        checkpoint()
        apart = np.abs(profile - others)
        if apart.max(axis=1).min() > maximum:  # no point is like this one
            return None
        row[:] = apart.sum(axis=1)
    from scipy.optimize import linear_sum_assignment  # slow to import

    checkpoint(SECONDS_PER_STEP * cost.size * len(cost))
    _, order = linear_sum_assignment(cost)
    return np.asarray(order, np.int64) if np.abs(one - two[np.ix_(order, order)]).max() <= maximum else None


def is_same_body(first: Floats, second: Floats) -> bool:
    """Whether the points of one body (n, k) are those of another one in another pose, and no mirror image."""
    if first is second:
        return True
    if (order := twin_points(first, second)) is None:
        return False
    second = second[order]
    left, sizes, right = np.linalg.svd((first - first.mean(axis=0)).T @ (second - second.mean(axis=0)))
    return bool(np.linalg.det(left @ right) > 0.0 or sizes[-1] <= SAME_SHAPE * sizes[0])

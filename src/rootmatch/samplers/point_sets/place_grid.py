"""Which points many motions bring near targets, by a grid of the places where a target is near.

Of each motion nearly all points come to where no target is. A cell of the grid lists the targets that are within the
gate of any of its places, so that only points in a cell with a list are compared with anything.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.deadline import checkpoint
from rootmatch.problems.points import PointClouds
from rootmatch.samplers.point_sets.kernels import list_pairs
from rootmatch.samplers.point_sets.motions import Motions, in_space

CELLS, MAXIMUM = 1_500, 1_000_000
"""Cells for each target, of which it is listed in some thirty, and most of all: those stay in the processor's cache.
Round values."""
STEPS = (-1.0, -0.4, 0.4, 1.0)
"""Distances from a target, in gates, from one to the next of which is less than a cell."""
SLACK = 1e-9
"""Share of a cell by which a list reaches farther."""
LISTING = 2.0
"""Time to compare a point with a target and to list the pair, over that to look up a cell. A round value."""
TESTED = 10_000_000
"""Pairs of points and targets, each with each, between two looks at the time: some milliseconds, if most are far."""


class Pairs(NamedTuple):
    """Pairs of points and targets that are near each other by some motions."""

    motion: Integers
    source: Integers
    target: Integers
    square: Floats
    """Squared distances of the targets from the moved points."""
    variance: Floats
    """Of a coordinate of these."""

    def take(self, which: Bools | slice) -> Pairs:
        """Some of them."""
        return Pairs._make([part[which] for part in self])


class PlaceGrid:
    """The targets of point clouds, by their places.

    Parameters
    ----------
    clouds : PointClouds
    gate : float
        Deviation in σ within which a target explains a point.
    allowed : (n, n') bool array, optional
        Which targets may be which points.
    """

    def __init__(self, clouds: PointClouds, gate: float, allowed: Bools | None) -> None:
        self.gate = gate
        target, spread = in_space(clouds.target), float(np.linalg.norm(np.ptp(clouds.source, axis=0)))
        low, box = target.min(axis=0), np.ptp(target, axis=0)
        # as wide as the gate is if the source is twice as large as the targets
        scale = 2.0 * float(np.linalg.norm(box)) / max(spread, 1e-300) if clouds.scaled else 1.0
        own = scale**2 * clouds.source_variance.max() + clouds.target_variance.max()
        maximum = min(CELLS * len(target), MAXIMUM) ** (1.0 / clouds.target.shape[1])  # along an axis
        reach = max(gate * math.sqrt(float(own)), float(box.max()) / maximum, 1e-300)
        shape = np.ceil(box / reach).astype(np.int64) + 5  # two about them, and what rounding takes
        low = low - 2.0 * reach
        steps = (1.0 + SLACK) * np.array(list(product(STEPS, repeat=3)))
        near = np.floor((target - low) / reach + steps[:, None]).astype(np.int64)
        number = (near[..., 0] * shape[1] + near[..., 1]) * shape[2] + near[..., 2]
        cell, listed = divmod(np.unique(number * len(target) + np.arange(len(target))), len(target))
        count = np.bincount(cell, minlength=math.prod(shape.tolist()))
        begin = np.concatenate([[0], np.cumsum(count)])
        self.grid = low, shape, reach, count > 0, begin, np.ascontiguousarray(listed), reach * (1.0 + SLACK)
        among = count.reshape(shape)[2:-2, 2:-2, 2:-2].mean()
        self.cost = int(len(clouds.source) * max(1.0, LISTING * float(among)))
        """Points that are looked up in the time it takes for a motion that brings all of them among the targets."""
        possible = np.empty((0, 0), np.bool_) if allowed is None else np.ascontiguousarray(allowed)
        variances = clouds.source_variance, clouds.target_variance
        self.points = np.ascontiguousarray(in_space(clouds.source).T), variances[0], target, variances[1], possible

    def explained(self, motions: Motions) -> Integers:
        """How many points (H,) of the set with fewer of them are within the gate of one of the other set."""
        counts = [np.empty(0, np.int64)]
        for found, count in self._parts(motions):
            met = [np.zeros((count, len(self.points[which])), np.bool_) for which in (1, 2)]
            met[0][found.motion, found.source] = True
            met[1][found.motion, found.target] = True
            counts.append(np.minimum(*(one.sum(axis=1) for one in met)))
        return np.concatenate(counts)

    def pairs(self, motions: Motions) -> Pairs:
        """All pairs of points and targets within the gate, by motion and point."""
        parts, start = list[Pairs](), 0
        for found, count in self._parts(motions):
            parts.append(found._replace(motion=found.motion + start))
            start += count
        return parts[0] if len(parts) == 1 else Pairs._make(map(np.concatenate, zip(*parts, strict=True)))

    def _parts(self, motions: Motions) -> Iterator[tuple[Pairs, int]]:
        """The same of some motions after others, each numbered from 0, and how many these are."""
        step, each = max(1, TESTED // (len(self.points[1]) * len(self.points[2]))), 16
        every = in_space(motions.linear), in_space(motions.shift), motions.scale
        for start in range(0, max(len(motions.scale), 1), step):
            checkpoint()
            some = tuple(part[start : start + step] for part in every)
            size = len(some[2])
            while True:
                room = each * size
                numbers, values = np.empty((3, room), np.int64), np.empty((2, room))
                found = Pairs._make([*numbers, *values])
                count = list_pairs(some, self.points, self.grid, self.gate, tuple(found))
                if count <= room:
                    break
                each = 1 + count // size
            yield found.take(slice(count)), size

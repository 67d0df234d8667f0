"""The survivors of a batch's sequential tests, those of the highest ratio: what of a batch is verified."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers


class Survivors(NamedTuple):
    """Hypotheses that a sequential test did not drop, those of the highest ratio first."""

    sets: Integers
    """(K,) number of the minimal set of each."""
    points: Integers
    """(K, m) source points of that set."""
    images: Integers
    """(K, 1 + m) number of the root, and image of each of those points."""
    ratios: Floats
    """(K,) log-likelihood ratios, descending."""

    @classmethod
    def of(cls, points: Integers, survivors: Integers, ratios: Floats, maximum: int) -> Survivors:
        """The ``maximum`` survivors of highest ratio of those (chunks, keep, m + 2) of the sets ``points`` (S, m)."""
        survivors, ratios = survivors.reshape(-1, survivors.shape[2]), ratios.reshape(-1)
        (chosen,) = (survivors[:, 0] >= 0).nonzero()
        chosen = chosen[(-ratios[chosen]).argsort(kind="stable")[:maximum]]
        survivors = survivors[chosen]
        sets = survivors[:, 0]
        return cls(sets, points[sets], survivors[:, 1:], ratios[chosen])

    def take(self, which: Bools | slice) -> Survivors:
        """A subset of the survivors."""
        return Survivors(self.sets[which], self.points[which], self.images[which], self.ratios[which])

    def without_assignment(self, assignment: Integers) -> Survivors:
        """Survivors that an assignment (n,) does not have."""
        return self.take((assignment[self.points] != self.images[:, 1:]).any(axis=1))

    def rivals_of(self, assignment: Integers, part: float) -> Survivors:
        """Survivors that may have another pose than an assignment (n,) and explain nearly as much.

        Another one has at least this part of the assignment's own ratio, if that was met again.
        """
        same = self._of(assignment)
        if not same.any():
            return self
        # the same images at two roots may be two poses: points on the axis of a symmetric object
        alone = same & (np.bincount(self.sets[same], minlength=int(self.sets.max()) + 1)[self.sets] == 1)
        return self.take((self.ratios >= part * self.ratios[same].max()) & ~alone)

    def met(self, assignment: Integers) -> int:
        """How many sets have met an assignment (n,)."""
        return len(np.unique(self.sets[self._of(assignment)]))

    def _of(self, assignment: Integers) -> Bools:
        """Which survivors have the images of an assignment (n,)."""
        return np.asarray((assignment[self.points] == self.images[:, 1:]).all(axis=1))

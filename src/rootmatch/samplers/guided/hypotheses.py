"""The hypotheses of a search, and the clusters that it ends with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers

SHARED = 0.5
"""Fraction of its matches from which a hypothesis is of the same pose as another that has them. A round value."""


class Hypotheses(NamedTuple):
    """K solved minimal sets and the correspondences that each predicts."""

    points: Integers
    """(K, m) source points of the minimal set."""
    images: Integers
    """(K, 1 + m) number of the root, and image of each of those points."""
    evidence: Floats
    """(K,) log-likelihood ratio against chance."""
    best: Integers
    """(K, n) image of each source point, −1 for none."""
    candidates: Integers
    """(K, n, c) images near the prediction, nearest first, then −1."""

    @classmethod
    def empty(cls, minimal: int, n: int, candidates: int) -> Hypotheses:
        """No hypotheses of minimal sets of some size, n source points and so many candidates for each."""
        return cls(
            np.empty((0, minimal), np.int64), np.empty((0, 1 + minimal), np.int64), np.empty(0),
            np.empty((0, n), np.int64), np.empty((0, n, candidates), np.int64),
        )  # fmt: skip

    @classmethod
    def joined(cls, batches: Sequence[Hypotheses]) -> Hypotheses:
        """The hypotheses of several batches, one batch after the other."""
        if len(batches) == 1:
            return batches[0]
        return cls._make(map(np.concatenate, zip(*batches, strict=True)))

    def take(self, which: NDArray[np.integer] | Bools) -> Hypotheses:
        """A subset of the hypotheses."""
        return Hypotheses._make(one[which] for one in self)

    def real(self) -> list[Hypotheses]:
        """Those whose root is there, if any is."""
        there = self.evidence > -np.inf
        return [self if there.all() else self.take(there)] if there.any() else []

    def assignments(self, which: Bools, maximum: int) -> Integers:
        """Assignments (A, n) of a subset, each once, in the order in which they come, ``maximum`` of them or fewer."""
        first: dict[bytes, int] = {}
        for number in which.nonzero()[0].tolist():
            first.setdefault(self.best[number].tobytes(), number)
        return np.ascontiguousarray(self.best[list(first.values())[:maximum]])

    def differs_from_first(self) -> Bools:
        """Which (K,) have less than `SHARED` of their matches in common with the first one: other poses."""
        common = ((self.best == self.best[:1]) & (self.best >= 0)).sum(axis=1)
        return np.asarray(common < SHARED * (self.best >= 0).sum(axis=1))

    def apart_from_first(self) -> Bools:
        """Which (K,) have no detection of the first one."""
        return np.asarray(~np.isin(self.best, self.best[:1][self.best[:1] >= 0]).any(axis=1))

    def strongest(self, maximum: int) -> Hypotheses:
        """The ``maximum`` hypotheses of highest evidence, or fewer, strongest first."""
        return self.take(np.argsort(-self.evidence, kind="stable")[:maximum])


class HypothesisClusters(NamedTuple):
    """G clusters of hypotheses that match the same points, strongest first."""

    lists: Integers
    """(G, n, c) candidate images of each source point, −1 for none."""
    evidence: Floats
    """(G,) of the strongest hypothesis of each."""
    false_alarm_level: float
    """Evidence that chance may reach."""


def strongest_assignment(batches: Sequence[Hypotheses]) -> Integers:
    """Assignment (n,) of the hypothesis with the highest evidence."""
    strongest = max(batches, key=lambda batch: float(batch.evidence.max()))
    return np.asarray(strongest.best[strongest.evidence.argmax()])


def recurrence_miss_probability(best: Integers, drawn: Sequence[Hypotheses]) -> float:
    """Probability of not having met a pose that is as easy to meet as that of an assignment (n,).

    That was met by some of the minimal sets that were ``drawn``, each a batch, once and then so many times again. Of a
    Poisson process that had k events and whose mean may be anything, an equal one has none with the probability 2⁻ᵏ.
    """
    met = [one.points[(best[one.points] == one.images[:, 1:]).all(axis=1)] for one in drawn]
    return 0.5 ** max(sum(len(np.unique(np.sort(sets, axis=1), axis=0)) for sets in met if len(sets)) - 1, 0)

"""What a search finds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.samplers.guided.verification import CANDIDATES

Integers = NDArray[np.int64]


class Proposals(NamedTuple):
    """K solved minimal sets and what they propose."""

    points: Integers
    """(K, m) source points of the minimal set."""
    images: Integers
    """(K, 1 + m) root, and image of each of those points."""
    evidence: NDArray[np.float64]
    """(K,) log-likelihood ratio against chance."""
    best: Integers
    """(K, n) image of each source point, −1 for none."""
    candidates: Integers
    """(K, n, CANDIDATES) images near the prediction, nearest first, then −1."""

    @classmethod
    def joined(cls, parts: Sequence[Proposals], minimal: int, n: int) -> Proposals:
        """All of some, one after the other; ``minimal`` and n say what none of them looks like."""
        if not parts:
            return cls(
                np.empty((0, minimal), np.int64), np.empty((0, 1 + minimal), np.int64), np.empty(0),
                np.empty((0, n), np.int64), np.empty((0, n, CANDIDATES), np.int64),
            )  # fmt: skip
        if len(parts) == 1:
            return parts[0]
        return cls(
            np.concatenate([part.points for part in parts]),
            np.concatenate([part.images for part in parts]),
            np.concatenate([part.evidence for part in parts]),
            np.concatenate([part.best for part in parts]),
            np.concatenate([part.candidates for part in parts]),
        )

    def taken(self, which: NDArray[np.integer] | NDArray[np.bool_]) -> Proposals:
        """Some of them."""
        return Proposals(
            self.points[which], self.images[which], self.evidence[which], self.best[which], self.candidates[which]
        )

    def strongest(self, most: int) -> Proposals:
        """The first of them by evidence, the strongest first."""
        return self.taken(np.argsort(-self.evidence, kind="stable")[:most])


class Found(NamedTuple):
    """G groups of like proposals, strongest first."""

    lists: Integers
    """(G, n, c) candidate images of each source point, −1 for none."""
    evidence: NDArray[np.float64]
    """(G,) of the strongest of each."""
    accident: float
    """Evidence that chance may reach."""

"""What the search between two views finds: a relative pose and its matches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rootmatch.arrays import Floats, Integers

SAME, OTHER = 0.7, 0.3
"""Shares of matches from which two assignments are the same, and up to which they are of poses that have nothing to do
with one another. Round values."""


def shared_match_share(assignments: Integers, other: Integers) -> Floats:
    """Share (…,) of the matches of assignments (…, n) that another one (n,) has too."""
    matched = assignments >= 0
    common = ((assignments == other) & matched).sum(axis=-1)
    return np.asarray(common / np.maximum(matched.sum(axis=-1), 1))


@dataclass(frozen=True)
class RelativeHypothesis:
    """A refined relative pose and the assignment that it makes likeliest."""

    evidence: float
    """Log-likelihood ratio of the assignment against clutter."""
    assignment: Integers
    """(n,) image of each source point, −1 for none."""
    ratios: Floats
    """(n, n') likelihood ratios of all pairs."""
    minimal_set: int
    """Number of the minimal set that led to it."""
    tilt: Floats
    """(2,) of the common direction."""

    def shared(self, other: RelativeHypothesis) -> float:
        """Share of the matches that another assignment has too."""
        return float(shared_match_share(self.assignment, other.assignment))

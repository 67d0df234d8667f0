"""What the search between two views finds: a relative pose and its matches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
SAME = 0.7
"""Share of matches from which two assignments are the same. A round value."""


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

    def shared(self, other: RelativeHypothesis) -> float:
        """Share of the matches that another assignment has too."""
        common = (self.assignment == other.assignment) & (self.assignment >= 0)
        return float(common.sum() / max((self.assignment >= 0).sum(), 1))

    def like(self, other: RelativeHypothesis) -> bool:
        """Whether two assignments have so much in common that they come from one pose."""
        return self.shared(other) >= SAME

"""The pool of assignments that the posterior weighs: each fitted by one pose, valued side by side."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import Pace
from rootmatch.explain.detection_odds import PosteriorOptions
from rootmatch.explain.task import MatchingTask
from rootmatch.problems.pose_fit.relative import RelativeFit

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(eq=False)
class FittedPool:
    """Assignments with at least ``least`` matches, each once, and the fits of the first of them.

    Attributes
    ----------
    assignments : list of (n,) int64 arrays
        In the order in which they came.
    fits : list of (RelativeFit, int)
        Fits of the first assignments, each with its row.
    """

    task: MatchingTask
    least: int
    options: PosteriorOptions
    assignments: list[Integers] = field(default_factory=list)
    fits: list[tuple[RelativeFit, int]] = field(default_factory=list)
    _known: set[bytes] = field(default_factory=set)
    _batches: list[RelativeFit] = field(default_factory=list)
    _images: Integers = field(default_factory=lambda: np.empty((0, 0), np.int64))

    def add(self, assignment: Integers) -> None:
        """Add an assignment, unless the pool has it or it is too small."""
        key = assignment.tobytes()
        if key not in self._known and np.count_nonzero(assignment >= 0) >= self.least:
            self._known.add(key)
            self.assignments.append(assignment)

    def holds(self, assignment: Integers) -> bool:
        """Whether the pool has an assignment."""
        return assignment.tobytes() in self._known

    def fit(self, pace: Pace) -> None:
        """Fit the assignments that are not fitted yet, as many as time allows."""
        while len(self.fits) < len(self.assignments) and (few := pace.block(len(self.assignments) - len(self.fits))):
            some = np.array(self.assignments[len(self.fits) : len(self.fits) + few])
            fit = self.task.problem.fitted(self.task.points, some)
            assert isinstance(fit, RelativeFit)  # the model of an image judges poses of one camera
            self.fits += [(fit, k) for k in range(len(some))]
            self._batches.append(fit)
            self._images = np.concatenate([self._images, some]) if self._images.size else some

    def values(self, odds: Floats, detected: float, inflation: float) -> Floats:
        """Log posterior (K,) of the fitted assignments up to a constant, −∞ where there is no pose.

        Parameters
        ----------
        odds : (n, n') array
            Log prior odds of each correspondence.
        detected : float
            Probability that a point is detected.
        inflation : float
            Factor on all variances.
        """
        if not self.fits:
            return np.empty(0)
        matched = self._images >= 0
        evidence = np.concatenate([fit.inflated(inflation) for fit in self._batches])
        of_pairs = np.where(matched, odds[np.arange(odds.shape[0]), np.maximum(self._images, 0)], 0.0).sum(axis=1)
        value = evidence + of_pairs + np.log1p(-detected) * matched.shape[1]
        value = value + (np.log(detected) - np.log1p(-detected)) * np.count_nonzero(matched, axis=1)
        return np.where(np.isfinite(value), value, -np.inf)

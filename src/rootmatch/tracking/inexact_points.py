"""What the frames of a sequence tell of points that are off, though no noise of them was stated.

A single frame does not tell such errors from noise of the detections that is larger than stated. But the errors are the
same in each frame, and noise is drawn anew: residuals that stay are of the points. Once that is certain, they have a
noise as if it had been stated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.inexact_points import error_gains
from rootmatch.model.image_alike import OWN
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.tracking.mistaken_identity import TEMPER

LEAST = 8.0 * math.log(WRONG_MODEL)
"""Log-odds from which frames are not asked any more: points stay as they are."""
FRAME = -0.5 * math.log(WRONG_MODEL)
"""Log-odds that one frame adds at most."""


@dataclass
class InexactPoints:
    """Whether the points of a followed body are off."""

    log_odds: tuple[float, ...] = (0.0,) * OWN
    """By the fit of the frames so far; see `MatchingTask.log_inexact`."""
    log_stay: float = math.log(WRONG_MODEL)
    """That residuals which are too large stay the same (a test of Page, 1954)."""
    error: float | None = None
    """Standard deviation of a coordinate, once it is certain."""

    def take(self, found: Finding | None, stays: float | None) -> None:
        """Learn from a frame of a single body.

        ``stays``: log-odds, by the residuals of this frame and those of the one before, that they stay.
        """
        if found is None or found.status is not Status.MATCHED or self.error is not None:
            return
        if found.labellings is None and (found.model is None or len(found.model.images) > 1):
            return
        if not found.point_error and found.task.points.source_covariance is not None:
            return
        if not found.point_error:
            if self.log_odds[-1] > LEAST and found.noise_dof and found.noise_factor is not None:
                gains = [min(max(TEMPER * gain, -FRAME), FRAME) for gain in error_gains(found).tolist()]
                told = [one + gain for one, gain in zip(self.log_odds, gains, strict=True)]
                self.log_odds = tuple(min(max(one, LEAST), 0.0) for one in told)
            return
        self.log_odds = tuple(min(one + FRAME, 0.0) for one in self.log_odds)
        if stays is not None:
            self.log_stay = max(self.log_stay + min(max(stays, -FRAME), FRAME), math.log(WRONG_MODEL))
        if self.log_stay > 0.0:
            self.error = found.point_error

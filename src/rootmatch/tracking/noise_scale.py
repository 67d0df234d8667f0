"""The noise of a sequence: how much larger its residuals are than the σ that was stated.

A calibration that is off by a pixel is so in every frame, so what one frame tells of σ is the prior of the next one:
the inverse gamma distribution of the variances' factor s², of which the model of an image integrates the rest.
"""

from __future__ import annotations

import math

from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import MOST_INFLATION
from rootmatch.model.priors import NOISE_FREEDOM

MOST_FREEDOM = 1000.0
"""Residuals that are remembered, those of some thirty frames: the factor may change, as with a lens that warms up. A
round value."""
MOST, MOST_OF_RIG = math.sqrt(MOST_INFLATION), 4.0
"""Largest factor on σ that is believed: of one camera as of one image, and of a rig, whose calibration may be off by
more than the noise: a pose takes up what is wrong with one camera, not what is wrong between several. What fits with no
less is another object: of 1,440 frames that show the asked ring of LEDs beside one of another layout, which came first,
491 were trusted for the wrong one with 4.0, 136 with 2.0. The second is a round value."""


class NoiseScale:
    """The factor on the stated σ that the frames so far suggest; at least 1."""

    def __init__(self) -> None:
        self.chi2 = self.freedom = 0.0

    @property
    def factor(self) -> float:
        """Of σ."""
        return max(math.sqrt((NOISE_FREEDOM + self.chi2) / (NOISE_FREEDOM + self.freedom)), 1.0)

    def take(self, found: Finding, factor: float) -> None:
        """Take in the residuals of a frame's finding, which was made with σ times a factor.

        They count if the pose is certain, whether or not it fits: that no pose fits as well says that σ is too small.
        Those of points in space do not: they are weighed with σ as it was stated.
        """
        if not found.task.problem.takes_prior:
            return
        facts, dof, ratio = found.facts, found.noise_dof, found.noise_factor
        sure = facts.sure_of_the_rest and facts.present is not None and facts.present >= facts.min_probability
        most = MOST if found.task.rig is None else MOST_OF_RIG
        if not sure or not dof or ratio is None or not ratio * factor <= most:
            return
        self.chi2 += dof * (ratio * factor) ** 2
        self.freedom += dof
        if self.freedom > MOST_FREEDOM:
            kept = MOST_FREEDOM / self.freedom
            self.chi2, self.freedom = kept * self.chi2, MOST_FREEDOM

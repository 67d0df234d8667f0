"""Seconds between the frames of a tracker: that times are given in milliseconds is noticed."""

from __future__ import annotations

import warnings
from statistics import median

from rootmatch.errors import InputWarning

SLOW = 1.0
"""Seconds between two frames beyond which a time is hardly one in seconds. Not tuned."""
FIRST_STEPS = 5
"""Steps whose median is looked at: a pause among them is no reason to warn. Not tuned."""


class FrameSteps:
    """The first steps of the times that a tracker is given, in seconds."""

    def __init__(self) -> None:
        self.steps: list[float] = []

    def take(self, step: float) -> None:
        """Count one more step; warn the caller of the caller once, where most of the first ones are slow."""
        if len(self.steps) == FIRST_STEPS:
            return
        self.steps.append(step)
        if len(self.steps) == FIRST_STEPS and (step := median(self.steps)) > SLOW:
            text = f"time: the frames are {step:.3g} s apart; where times are in milliseconds, divide them by 1000"
            warnings.warn(text, InputWarning, stacklevel=3)

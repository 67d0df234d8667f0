"""What one frame of a tracker searches, whose searches go on over frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rootmatch.explain.finding import Finding
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.posterior import Posterior
from rootmatch.model.prediction import COMPLETE


class SearchPart(NamedTuple):
    """The part of a search that one frame takes."""

    body: int
    camera: int | None = None
    """Of a rig; None for one image. A single body is searched for in all."""
    rest: bool = False
    """Whether among those detections only that its prediction leaves."""
    share: float = 1.0
    """Share of its budget that it may take."""
    tried: tuple[int, ...] = ()
    """Other bodies on whose detections this one was tried before; what they certainly have is left out."""

    def of(self, task: MatchingTask) -> MatchingTask:
        """The part of a task."""
        budget = None if task.budget is None else round(self.share * task.budget)
        return copy_with(task, search_camera=self.camera, budget=budget)


Choice = Callable[[Finding], SearchPart | None]
"""Says what to search, None for nothing, given the finding about predicted poses."""


def is_mostly_shown(told: Posterior, mode: int = 0) -> bool:
    """Whether a body has detections for most of the points that are visible in one of its poses."""
    if len(told.probabilities) <= mode:
        return False
    matched = np.count_nonzero(told.modes.assignments[mode] >= 0)
    return bool(matched >= COMPLETE * float(told.modes.visible[mode].sum()))

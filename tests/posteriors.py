"""The posterior of a task by assignments that a test names."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.image_hypotheses import Candidate, weigh_candidates
from rootmatch.explain.task import MatchingTask
from rootmatch.model.posterior import Posterior


def told_of(*found: tuple[MatchingTask, list[NDArray[np.int64]]]) -> list[Posterior]:
    """The posterior of each of several bodies by the assignments that were found of it."""
    return weigh_candidates([Candidate.of(task, assignments) for task, assignments in found])


def told(task: MatchingTask, assignments: list[NDArray[np.int64]]) -> Posterior:
    """That of one body."""
    return told_of((task, assignments))[0]

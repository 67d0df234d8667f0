"""Whether detections are too few to tell any pose from chance, which is known before a search."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.task import MatchingTask
from rootmatch.model.evidence import max_log_evidence
from rootmatch.problems.p3p import P3P
from rootmatch.problems.up2p import UP2P

MOST_MORE = 3
"""Most detections beyond a minimal set for which this is asked: more are hardly ever too few. A round value."""


def are_too_few(task: MatchingTask, log_share: float = 0.0) -> bool:
    """Whether chance is expected to bring a pose that is as good as any that the detections can tell.

    Every minimal set of points and detections has a pose, and the evidence of a pose comes by chance at most once in as
    many trials as it says. So what a search finds is not believed, the right pose or another. ``log_share``: logarithm
    of the prior probability of the poses that are searched.
    """
    (n, n_target), minimal = task.shape, task.minimal
    alone = task.rig is None and task.bodies is None and not task.has_prior and task.weights is None
    # with normals most sets cannot be seen together, and nobody has counted the others
    if not alone or task.points.normals is not None or not isinstance(task.problem, P3P | UP2P):
        return False
    if not minimal < min(n, n_target) <= minimal + MOST_MORE or task.options.packs_motions:
        return False
    share = 1.0 if task.allowed is None else float(np.mean(task.allowed))
    if share == 0.0:
        return False
    sets = math.log(math.comb(n, minimal)) + math.log(math.perm(n_target, minimal)) + minimal * math.log(share)
    return max_log_evidence(Candidate.make_model(task), minimal) + log_share < sets

"""Matches that are doubtful by the frames before: they are left out, as those are that are doubtful by an image alone.

That one point may show something else makes no pose doubtful which many others determine. Otherwise a body whose
points are hidden now and then, each of them for a frame, is hardly trusted at all.
"""

from __future__ import annotations

import numpy as np

from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.image_decision import KEPT
from rootmatch.frozen import copy_with
from rootmatch.model.pose_density import LEAST
from rootmatch.model.posterior import Others, drop_doubtful_matches


def drop_doubtful(found: Finding, weighed: Finding) -> Finding:
    """What was found without the matches that are doubtful, if it is trusted then; else as it was weighed.

    Parameters
    ----------
    found : Finding
        By a frame, about a predicted pose.
    weighed : Finding
        The same with the confidence that the frames before leave.
    """
    least, told, confidence = found.facts.min_probability, found.posterior, weighed.confidence
    if found.status is not Status.MATCHED or weighed.status is Status.MATCHED or told is None or confidence is None:
        return weighed
    matched = found.assignment >= 0
    pose = float(confidence[matched].max(initial=0.0))
    if pose < least:
        return weighed
    believed = drop_doubtful_matches(found.assignment, confidence, pose, least, pose=pose)
    kept, every = believed.assignment >= 0, np.count_nonzero(told.modes.assignments[found.mode] >= 0)
    if np.count_nonzero(kept) < LEAST or believed.known < KEPT * every:
        return weighed
    return copy_with(
        found.with_facts(probability=believed.probability),
        assignment=believed.assignment,
        confidence=np.where(matched & ~kept, 1.0 - confidence, confidence),
        others=Others(told, TRUST.alternatives, than=believed.assignment),
    )

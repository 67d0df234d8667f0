"""Whether what is followed is the body: something else of nearly its shape betrays itself by how it fits.

A prediction counts for whatever is there, the body, its reflection, or another model of a controller: each of them is
found where it was expected. What tells them apart is how well the detections fit the body: see
`rootmatch.explain.goodness_of_fit`. The odds are those of a test of both, frame by frame, but for frames that nothing
explains, and never below the first ones: the body may have been exchanged since (Page 1954).

What was given up as something else is still there: what is found in its place next has its odds, for a while.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import MAX_ALIKE, Misfit
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.tracking.motion_filter import MotionFilter

FLOOR = math.log(WRONG_MODEL)
"""Log-odds at first, and the least: those of a wrong model."""
TEMPER = 0.5
"""Weight of a frame's evidence: errors of the source points, or a σ that is stated too small, act in the same way in
every frame. The weight delays decisions; it does not change which pose leads."""
GIVEN_UP = math.log(9.0)
"""Log-odds from which a pose is no longer followed. A round value."""
STAYS = 1.0
"""Seconds within which something else leaves its place. A round value, that of a body."""
AT_ORIGIN = np.zeros((1, 3))
"""Centre of a single camera."""


def seeing_centres(found: Finding, assignment: Integers) -> Floats | None:
    """Centres (C, 3) of the cameras that see points with an assignment, in the frame of a pose; None in a space."""
    if found.labellings is not None:
        return None
    if (rig := found.task.rig) is None:
        return AT_ORIGIN
    return np.asarray(rig.centres[(assignment >= 0).reshape(len(rig.views), -1).any(axis=1)])


def log_other_presence(given_up: MotionFilter, pose: Pose, time: float, centres: Floats | None = AT_ORIGIN) -> float:
    """Log-odds that what is found with a pose is what was given up, by where it is seen; see `seeing_centres`.

    They begin anew with those at which it was given up, whatever they have become: the body may have come there since.
    """
    if not given_up.is_in_sight(pose, time, centres):
        return FLOOR
    return float(np.logaddexp(GIVEN_UP - (time - given_up.time) / STAYS, FLOOR))


def update_identity(
    log_odds: float, misfit: Misfit, weight: float, of_rig: bool = False, *, as_off: float = 0.0, minimum: float = FLOOR
) -> float:
    """Log-odds, after a frame, that what is followed is something else; at ``minimum`` some.

    ``misfit``: of the detections about the pose. ``weight``: of a frame's evidence, as what spoils one fit may spoil
    the next. ``as_off``: log-odds of the body with points that are off, of that as given, if it is the former.
    """
    if not misfit.dof and misfit.alike is None:
        return log_odds
    other = misfit.odds_of_something_else(of_rig) * math.exp(-as_off)

    def after(odds: float) -> float:
        return max(log_odds + weight * math.log(odds / (1.0 - WRONG_MODEL + WRONG_MODEL * odds)), minimum)

    if misfit.another == -math.inf:
        return after(other)
    return max(after(other), min(after(other + math.exp(min(misfit.another - FLOOR, MAX_ALIKE))), misfit.another))

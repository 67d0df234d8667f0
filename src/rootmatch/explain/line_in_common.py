"""Something else that has one line of points in common with a body, of which an image shows nothing but that line.

Another body on the same tube, the mirror image, or a body on its head has the points of one edge where they are, and
its others elsewhere. Before an upright camera these few tell a pose, whose other points have no detection. That just
those of a line are detected is an accident for the body, and none for what has only the line in common with it. Points
of a plane do not tell that: the face of an opaque body hides all others.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.explain.more_places import log_shown_chance
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.image_alike import ERRORS
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import MINIMUM
from rootmatch.model.priors import WRONG_MODEL


def log_odds_of_line(model: DetectionModel, modes: Modes, k: int) -> float:
    """Log-odds of something else that shares a line with a body, of the body in one of its modes.

    What it has in common is a line that a point drawn at random lies on; of its other points nothing is known. −∞ if
    the matches are on no line, or all points are.
    """
    matched, points = modes.assignments[k] >= 0, model.points
    if np.count_nonzero(matched) < MINIMUM:
        return -math.inf
    centre, near = points[matched].mean(axis=0), ERRORS[0] * model.radius
    _, sizes, axes = np.linalg.svd(points[matched] - centre)
    own = matched | (np.linalg.norm((points - centre) @ axes[1:].T, axis=1) < near)
    if sizes[1] > near or own.all():
        return -math.inf
    shown = log_shown_chance(modes.visible[k][own], matched[own], *model.rate_quadrature)
    others = float(modes.log_odds[k] - modes.detected[k] - modes.log_mass[k])
    return others + shown + math.log(WRONG_MODEL * own.mean())

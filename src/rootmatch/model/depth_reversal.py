"""The second pose of a flat object: the same matches with their depth reversed.

From afar, what is nearly flat fits its image in two poses (Schweighofer & Pinz 2006), which meet where it faces the
camera. A search need not meet both, and neither is a change of the other's assignment.
"""

from __future__ import annotations

import numpy as np

from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.proposals import Proposals
from rootmatch.model.views import frames_of
from rootmatch.problems.pose_fit.starts import reflected


def reversed_in_depth(model: DetectionModel, proposals: Proposals) -> Proposals:
    """The other poses that nearly flat points have from afar, with the same matches, for the camera that has most."""
    points = np.broadcast_to(model.points - model.centre, (len(proposals.assignments), *model.points.shape))
    matched = (proposals.assignments >= 0).astype(np.float64)
    rotations, translations = frames_of(model.camera)
    camera = matched.reshape(len(matched), len(rotations), -1).sum(axis=2).argmax(axis=1)
    centre = -(rotations[camera].swapaxes(1, 2) @ translations[camera][..., None])[..., 0]
    rotation, place = reflected((proposals.rotation, proposals.position - centre), points, matched)
    return Proposals(proposals.assignments, rotation, place + centre)

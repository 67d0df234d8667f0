"""The second pose of a flat object: the same matches with their depth reversed.

From afar, what is nearly flat fits its image in two poses (Schweighofer & Pinz 2006), which meet where it faces the
camera. A search need not meet both, and neither is a change of the other's assignment.
"""

from __future__ import annotations

import numpy as np

from rootmatch.model.compiled.reversal import reverse_depth
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.proposals import Proposals
from rootmatch.model.views import camera_frames


def reverse_depths(model: DetectionModel, proposals: Proposals) -> Proposals:
    """The other poses that nearly flat points have from afar, with the same matches, for the camera that has most."""
    assignments = np.array(proposals.assignments, np.int64)
    poses = np.array(proposals.rotation, order="C"), np.array(proposals.position, order="C")
    out = np.empty(poses[0].shape), np.empty(poses[1].shape)
    reverse_depth(assignments, model.centred_body[0], poses, camera_frames(model.camera), out)
    return Proposals(proposals.assignments, *out)

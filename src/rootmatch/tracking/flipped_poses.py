"""Other poses of the same matches: four points in an image, or any number in a plane, may have two."""

from __future__ import annotations

import numpy as np

from rootmatch.explain.finding import Finding
from rootmatch.model.depth_reversal import reversed_in_depth
from rootmatch.model.evidence import settled_about, stepped
from rootmatch.model.pose_density import Doubted
from rootmatch.model.proposals import Proposals, joined, poses_of_few
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.reference_point import about_point


def flipped_poses(found: Finding) -> list[tuple[Pose, float]]:
    """The poses that may fit the matches of a frame, and their log-odds to the best mode's own, the best first.

    Without the prediction, which stays with one of them, and apart from which points are shown.
    """
    told, model = found.posterior, found.model
    if told is None or model is None or not len(told.probabilities):
        return []
    prior = model.prior.without if isinstance(model.prior, Doubted) else model.prior
    modes = told.modes.take(slice(1))
    first = Proposals(modes.assignments, modes.rotation, modes.position)
    few = joined([first, poses_of_few(model, modes.assignments), reversed_in_depth(model, first)])
    of_few, at = settled_about(model, *few, prior)
    rotation, position = stepped(of_few, at)
    lead = of_few.of_places
    if not np.isfinite(lead[0]):
        return []
    lead -= lead[0]
    every = []
    for k in np.argsort(-lead, kind="stable")[: np.isfinite(lead).sum()].tolist():
        at_origin = about_point(rotation[k], position[k], of_few.covariance[k], -model.centre)
        every.append((Pose.unchecked(rotation[k], *at_origin), float(lead[k])))
    return every

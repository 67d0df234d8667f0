"""Hypotheses of an upright camera of unknown focal length: as `image_hypotheses`, each with its own focal length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.explain.image_hypotheses import Candidate, select_determined
from rootmatch.explain.likeness import symmetry_images
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.model.evidence import Evidence
from rootmatch.model.linearised import Linearised
from rootmatch.model.modes import Modes
from rootmatch.model.proposals import (
    Proposals,
    empty_proposals,
    join_proposals,
    look_alikes,
    refit_proposals,
    reverse_depths,
)
from rootmatch.model.zoom_model import ZoomModel, decode_zoom
from rootmatch.problems.base import Problem
from rootmatch.problems.pose_fit.descent import ROUGH_STEPS
from rootmatch.problems.pose_fit.zoom_pose import zoom_fits
from rootmatch.problems.up2pf import UP2PF

VALLEYS = 4
"""Fits of each assignment that are weighed, the lowest ones. A round value."""
UPRIGHT = 0.1
"""Tilt in radians beyond which a twin's pose is not taken upright: it would be another pose. A round value."""


def has_image_model(problem: Problem) -> bool:
    """Whether a pose of one camera, or of a rig, is fitted to points in space."""
    return problem.takes_prior or isinstance(problem, UP2PF)


def make_candidate(task: MatchingTask, assignments: list[Integers], tensor: AffinityTensor | None = None) -> Candidate:
    """`Candidate.of` a task, by the model of its problem."""
    kind = ZoomCandidate if isinstance(task.problem, UP2PF) else Candidate
    return kind.of(task, assignments, tensor)


class ZoomCandidate(Candidate):
    """A body before a camera of unknown focal length."""

    model: ZoomModel

    @staticmethod
    def make_model(task: MatchingTask) -> ZoomModel:
        """See `Candidate.make_model`."""
        problem, points = task.problem, task.points
        assert isinstance(problem, UP2PF)
        return ZoomModel.of(
            np.array(problem.centre), problem.upright, points.source, points.target, sigma=points.target_noise,
            rate=task.options.detection_rate, allowed=task.allowed,
            log_weights=task.log_weights,
        )  # fmt: skip

    def poses_of(self, rows: Integers) -> Proposals:
        """See `Candidate.poses_of`: of whole hyper-edges, as three matches have hardly fewer poses than a body."""
        return self._pose_fits(rows, 0, 1)

    def proposals(self, assignments: Sequence[Integers]) -> Proposals:
        """See `Candidate.proposals`: the lowest fits of each."""
        return self._pose_fits(select_determined(self.task, assignments), ROUGH_STEPS, VALLEYS)

    def fit(self, assignments: Integers) -> tuple[Proposals, Evidence, Linearised]:
        """See `Candidate.fit`: each at several poses."""
        return refit_proposals(self.model, self.proposals(list(assignments)))

    def twins(self, modes: Modes) -> Proposals:
        """See `Candidate.twins`: at the focal lengths of the poses that they are twins of."""
        upright, best = self.model.upright, Proposals(*modes[:3])
        log_zoom, level = decode_zoom(upright, best.rotation)
        images, parts = symmetry_images(self.task), [empty_proposals(self.task.rows)]
        for k in range(len(level)):
            first = best._replace(rotation=level).take(slice(k, k + 1))
            twins = [reverse_depths(self.model, first)]
            twins += [look_alikes(first, self.model.points, self.model.points, image[None]) for image in images]
            every = join_proposals(twins)
            along = (every.rotation @ upright.world[1] * upright.camera[1]).sum(axis=1)
            every = every.take(np.flatnonzero(along >= np.cos(UPRIGHT)))
            log_focal = np.full(len(every.rotation), log_zoom[k] + np.log(self.model.camera.focal))
            own = self.model.encode_focal(decode_zoom(upright, every.rotation)[1], log_focal)
            parts.append(every._replace(rotation=own))
        return join_proposals(parts)

    def _pose_fits(self, rows: Integers, steps: int, maximum: int) -> Proposals:
        """Assignments (K, n) with their lowest fits after some steps, at most ``maximum``, of those that there are."""
        problem = self.task.problem
        assert isinstance(problem, UP2PF)
        if not len(rows):
            return empty_proposals(self.task.rows)
        centre, usual = np.array(problem.centre), self.model.camera.focal
        fits = zoom_fits(self.task.points, centre, problem.upright, rows, steps, usual=usual, maximum=maximum)
        of, which = np.nonzero(np.isfinite(fits.chi2))
        rotation = self.model.encode_focal(fits.rotation[of, which], fits.log_focal[of, which])
        return Proposals(rows[of], rotation, fits.position[of, which])

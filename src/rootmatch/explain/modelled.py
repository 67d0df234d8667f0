"""The model of a matching task's image, and the poses of its assignments: from the pipeline to `rootmatch.model`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.near_symmetries import symmetries_of
from rootmatch.explain.rig_copies import RigCopies
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.model.detection_model import ANY_POSE, DetectionModel
from rootmatch.model.pose_prior import PosePrior, Upright
from rootmatch.model.proposals import Proposals, joined, look_alikes, poses_of_few
from rootmatch.problems.pose_fit.absolute import AbsoluteFit
from rootmatch.problems.up2p import UP2P

Integers = NDArray[np.int64]

TWINS = 3
"""First proposals whose poses after the near symmetries of a body are proposed as well. A round value."""


def is_modelled(task: MatchingTask) -> bool:
    """Whether a task has a pose of its camera, in units of the noise: P3P and UP2P, and rigs."""
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    alone = not task.options.is_paper and not task.options.packs_motions
    return alone and in_noise and task.problem.takes_prior


def model_of(task: MatchingTask) -> DetectionModel:
    """The model of a task of one body."""
    points, problem = task.points, task.problem
    camera, target, sigma = problem.camera.chart(points.target, points.target_noise)  # type: ignore[attr-defined]
    prior: PosePrior = ANY_POSE
    if isinstance(problem, UP2P):
        world, vertical = np.asarray(problem.vertical_world, float), np.asarray(problem.vertical_camera, float)
        prior = Upright(world, vertical, float(problem.vertical_noise))
    log_weights = None
    if task.weights is not None:
        with np.errstate(divide="ignore"):
            log_weights = np.log(task.weights / max(float(task.weights.max(initial=0.0)), 1e-300))
    return DetectionModel(
        camera, points.source, target, sigma, points.normals, points.view_cosine,
        rate=task.options.detection_rate, prior=prior, allowed=task.allowed, log_weights=log_weights,
    )  # fmt: skip


def proposals_of(task: MatchingTask, model: DetectionModel, assignments: list[Integers]) -> Proposals:
    """Assignments with their fitted poses, all poses of those with few matches, and their near-symmetric ones."""
    n = task.shape[0]
    every = [one for one in assignments if np.count_nonzero(one >= 0) > task.problem.minimal]
    if not every:
        return Proposals(np.empty((0, n), np.int64), np.empty((0, 3, 3)), np.empty((0, 3)))
    rows = np.array(every)
    fit = task.problem.fitted(task.points, rows)
    assert isinstance(fit, AbsoluteFit)
    unit = float(np.sqrt(((model.points - model.centre) ** 2).mean()))  # of the fits
    whole = np.isfinite(fit.chi2) & np.isfinite(fit.translation).all(axis=1)
    parts = [Proposals(rows[whole], fit.rotation[whole], unit * fit.translation[whole])]
    if not isinstance(task.problem, RigCopies):
        parts.append(poses_of_few(model, rows))
        if model.normals is not None:
            first = parts[0].take(np.arange(min(TWINS, int(whole.sum()))))
            for symmetry in symmetries_of(model.points, model.normals):
                parts.append(look_alikes(first, model.points, model.points, symmetry.image))
    return joined(parts)

"""From a task and the assignments that were found to what the model of its image says of them, and to a status.

One rule for every task with a pose of its camera, and for several bodies together: a body is believed if its pose is
probable enough, less what is not sure of its matches; it is ambiguous if it is in view with that probability but not
which pose it has; else nothing is trusted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.body_options import OPTIONS
from rootmatch.explain.decide import Status
from rootmatch.explain.detection_odds import candidate_log_odds
from rootmatch.explain.near_symmetries import symmetries_of
from rootmatch.explain.rig_copies import RigCopies, twin_of
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.model.competition import joint_posterior
from rootmatch.model.detection_model import ANY_POSE, DetectionModel
from rootmatch.model.pose_prior import PosePrior, Upright
from rootmatch.model.posterior import Posterior, modes_of
from rootmatch.model.proposals import Proposals, joined, look_alikes, poses_of_few
from rootmatch.problems.pose_fit.absolute import AbsoluteFit
from rootmatch.problems.up2p import UP2P

Integers = NDArray[np.int64]

TWINS = 4
"""First poses of a body whose near-symmetric ones, and look-alikes of another body, are proposed. A round value."""
LEAST, KEPT = 4, 0.9
"""Matches of a body that is believed: at least so many, and so large a part of its assignment. Round values."""

MIN_PROBABILITY = 0.95
"""Probability from which a pose is believed. On seeds from 1000 of benchmarks/evidence.py 0.9 believes 5 wrong ones
of 480 controllers that are looked for with 4 and 5 LEDs, 0.95 none, and both more right ones than `match` does."""


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
    log_weights = None if task.weights is None else candidate_log_odds(task)
    return DetectionModel(
        camera, points.source, target, sigma, normals=points.normals, view_cosine=points.view_cosine,
        rate=task.options.detection_rate, prior=prior, allowed=task.allowed, log_weights=log_weights,
    )  # fmt: skip


def posteriors_of(
    found: Sequence[tuple[MatchingTask, list[Integers]]], missed: Sequence[float] | None = None
) -> list[Posterior]:
    """The posterior of each of several bodies in one image, or of one, by the assignments that were found of each.

    Parameters
    ----------
    found : sequence of (MatchingTask, list of (n,) arrays)
        The task of each body with all detections, and its assignments, the best one first.
    missed : sequence of float, optional
        Probability for each that its right pose is not among them.
    """
    models = [model_of(task) for task, _ in found]
    proposed = [proposals_of(task, model, some) for (task, some), model in zip(found, models, strict=True)]
    modes = [modes_of(model, some) for model, some in zip(models, proposed, strict=True)]
    for k, (task, _) in enumerate(found):
        more = [proposed[k]]
        for other, (theirs, _) in enumerate(found):
            image = None if other == k else twin_of(theirs, task, OPTIONS.alike)
            if image is not None and len(modes[other].log_odds):
                best = modes[other].take(np.arange(min(TWINS, len(modes[other].log_odds))))
                seen = Proposals(best.assignments, best.rotation, best.position)
                more.append(look_alikes(seen, models[other].points, models[k].points, image))
        proposed[k] = joined(more)
    if len(found) > 1:
        modes = [modes_of(model, some) for model, some in zip(models, proposed, strict=True)]
    return joint_posterior(models, modes, missed)


def believed(told: Posterior, min_probability: float = MIN_PROBABILITY) -> tuple[Status, Integers]:
    """The status of a body by its posterior, and the assignment to report: without what is not sure, if it is believed.

    An assignment without matches if nothing was proposed.
    """
    if not len(told.probabilities):
        return Status.UNTRUSTED, np.full(told.modes.assignments.shape[1], -1, np.int64)
    first = told.modes.assignments[0]
    sure = told.believed(min_probability)
    if sure is not None and np.count_nonzero(sure >= 0) >= max(LEAST, KEPT * np.count_nonzero(first >= 0)):
        return Status.MATCHED, sure
    in_view = float(told.probabilities.sum()) >= min_probability
    return (Status.AMBIGUOUS if in_view else Status.UNTRUSTED), first


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

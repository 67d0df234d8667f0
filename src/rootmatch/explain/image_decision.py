"""From a task and the assignments that were found to what the model of its image says of them, and to a status.

One rule for every task with a pose of its camera, and for several bodies together: a body is believed if its pose is
probable enough, less what is not sure of its matches; it is ambiguous if it is in view with that probability but not
which pose it has; else nothing is trusted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import OutOfTime
from rootmatch.explain.assessment import does_not_fit
from rootmatch.explain.assignment_posterior import Misfit
from rootmatch.explain.body_options import OPTIONS
from rootmatch.explain.decide import TRUST, Facts, Status, decide
from rootmatch.explain.detection_odds import candidate_log_odds
from rootmatch.explain.finding import Finding
from rootmatch.explain.near_symmetries import symmetries_of
from rootmatch.explain.rig_copies import RigCopies, twin_of
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.model.competition import joint_posterior
from rootmatch.model.detection_model import ANY_POSE, DetectionModel
from rootmatch.model.mode_search import DEFAULT_POSTERIOR, modes_of
from rootmatch.model.modes import Modes
from rootmatch.model.pose_prior import PosePrior, Upright
from rootmatch.model.posterior import Posterior
from rootmatch.model.proposals import Proposals, joined, look_alikes, poses_of_few
from rootmatch.problems.pose_fit.absolute import AbsoluteFit
from rootmatch.problems.up2p import UP2P
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Solution

Integers = NDArray[np.int64]

TWINS = 4
"""First poses of a body whose near-symmetric ones, and look-alikes of another body, are proposed. A round value."""


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


def posteriors_of(found: Sequence[tuple[MatchingTask, list[Integers]]]) -> list[Posterior]:
    """The posterior of each of several bodies in one image, or of one, by the assignments that were found of each.

    Parameters
    ----------
    found : sequence of (MatchingTask, list of (n,) arrays)
        The task of each body with all detections, and its assignments, the best one first.
    """
    return competing([Candidate.of(task, assignments) for task, assignments in found])


@dataclass(frozen=True, eq=False)
class Candidate:
    """A body that may be in an image, with the poses that were proposed for it by itself."""

    task: MatchingTask
    model: DetectionModel
    proposals: Proposals
    modes: Modes

    @classmethod
    def of(cls, task: MatchingTask, assignments: list[Integers]) -> Candidate:
        """By the assignments that were found."""
        model = model_of(task)
        proposals = proposals_of(task, model, assignments)
        return cls(task, model, proposals, modes_of(model, proposals))


def competing(bodies: Sequence[Candidate]) -> list[Posterior]:
    """The posterior of each of several bodies in one image, look-alikes of the others' poses among their own."""
    every = []
    for body in bodies:
        more = [body.proposals]
        for other in bodies:
            image = None if other is body else twin_of(other.task, body.task, OPTIONS.alike)
            if image is not None and len(other.modes.log_odds):
                best = other.modes.take(np.arange(min(TWINS, len(other.modes.log_odds))))
                seen = Proposals(best.assignments, best.rotation, best.position)
                more.append(look_alikes(seen, other.model.points, body.model.points, image))
        every.append(body.modes if len(more) == 1 else modes_of(body.model, joined(more)))
    return joint_posterior([body.model for body in bodies], every)


def assessed(task: MatchingTask, sampled: SampledTensor, solution: Solution | None = None) -> Finding:
    """The finding of what a search named, or a solver: judged by the model of the image."""
    named = [] if solution is None else [solution.assignment, *(other for other, _ in solution.alternatives)]
    named += [] if sampled.assignments is None else list(sampled.assignments)
    named += [] if sampled.consensus is None else [sampled.consensus]
    try:
        (told,) = posteriors_of([(task, named)])
    except OutOfTime:
        told = None
    base = Finding(
        task=task,
        assignment=named[0] if named else np.full(task.shape[0], -1, np.int64),
        others=named[1 : 1 + TRUST.alternatives],
        facts=Facts(confirmed=False),
        tensor=sampled.tensor,
        soft=None if solution is None else solution.soft,
        converged=solution is None or solution.converged,
        evaluated=sampled.evaluated,
    )
    return base if told is None else told_by(base, told, sampled.missed)


def told_by(base: Finding, told: Posterior, missed: float = 0.0) -> Finding:
    """A finding with the assignment, its facts and its confidence as a posterior tells them.

    Parameters
    ----------
    base : Finding
        Of the same task.
    told : Posterior
    missed : float
        Probability that a pose which explains as much was never met.
    """
    n, least = base.task.shape[0], base.task.options.min_probability
    if not len(told.probabilities):
        none, floor = np.full(n, -1, np.int64), DEFAULT_POSTERIOR.wrong_model
        facts = Facts(present=0.0, probability=1.0 - floor, lead=0.0, min_probability=least)
        return replace(
            base, assignment=none, others=[], scores=None, facts=facts, confidence=np.full(n, 1.0 - floor), log_odds=0.0
        )
    every, modes = told.ranked(1 + TRUST.alternatives), told.modes
    first, probability, confidence = modes.assignments[0], told.probability, told.confidence
    others = [one for one in every if ((one >= 0) & (one != first)).any()]
    fault = Misfit.of(float(modes.squared[0]), round(float(modes.freedom[0])))
    sure = told.believed(least)
    matched = int(np.count_nonzero(first >= 0))
    enough = max(base.task.problem.minimal + 1, TRUST.kept * matched)
    kept = 0 if sure is None else int(np.count_nonzero(sure >= 0))
    is_sure = kept >= enough and missed <= TRUST.missed
    facts = Facts(
        present=float(told.probabilities.sum()),
        false_alarms=math.inf if does_not_fit(fault) else -math.inf,
        contested=not is_sure,
        sure_of_the_rest=is_sure,
        probability=probability,
        min_probability=least,
    )
    if is_sure and sure is not None and decide(facts) is Status.MATCHED:
        left_out = (sure < 0) & (first >= 0)
        if left_out.any():
            others = every
            pose = float(told.probabilities[0])
            each = confidence[sure >= 0]
            facts = replace(facts, probability=min(pose * float(np.prod(each / each.max())), float(each.min())))
            confidence = np.where(left_out, told.unmatched, confidence)
            first = sure
    return replace(
        base,
        assignment=first,
        others=others[: TRUST.alternatives],
        facts=facts,
        scores=None,
        labels=None,
        confidence=confidence,
        log_odds=float(modes.log_odds[0]),
        noise_factor=fault.sigma,
    )


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
    if not isinstance(task.problem, RigCopies):  # a minimal set is of one camera
        parts.append(poses_of_few(model, rows))
    first = parts[0].take(np.arange(min(TWINS, int(whole.sum()))))
    for image in _symmetries(task):
        parts.append(look_alikes(first, model.points, model.points, image))
    return joined(parts)


def _symmetries(task: MatchingTask) -> list[Integers]:
    """Point at the place of each, or sighting, after motions that leave a body nearly as it is."""
    problem, normals = task.problem, task.points.normals
    if not isinstance(problem, RigCopies):
        return [found.image for found in symmetries_of(task.points.source, normals)]
    n, blocks = problem.copies.count, np.arange(len(problem.copies.offsets))[:, None]
    found = symmetries_of(problem.copies.points, None if normals is None else normals[:n])
    return [np.where(one.image >= 0, blocks * n + one.image, -1).ravel() for one in found]

"""From what was found of a task to what the model of its image says of it, and to the facts of a status.

One rule for every task with a pose of its camera, and for several bodies together: a body is believed if its pose is
probable enough, less what is not sure of its matches; it is ambiguous if it is in view with that probability but not
which pose it has; else nothing is trusted.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import cross_matrix
from rootmatch.deadline import OutOfTime
from rootmatch.explain.assessment import does_not_fit
from rootmatch.explain.assignment_posterior import Misfit
from rootmatch.explain.decide import TRUST, Facts, Status, decide
from rootmatch.explain.finding import Finding
from rootmatch.explain.image_hypotheses import Candidate, competing
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.model.mode_search import LEAST
from rootmatch.model.pose_prior import Doubted
from rootmatch.model.posterior import Posterior
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Solution

Integers = NDArray[np.int64]


def is_modelled(task: MatchingTask) -> bool:
    """Whether a task has a pose of its camera, in units of the noise: P3P and UP2P, and rigs."""
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    by_noise = (in_noise and not task.options.is_paper) or task.prior_pose is not None or bool(task.prior_poses)
    return by_noise and not task.options.packs_motions and task.problem.takes_prior


def assessed(task: MatchingTask, sampled: SampledTensor, solution: Solution | None = None) -> Finding:
    """The finding of what a search named, or a solver: judged by the model of the image."""
    named = [] if solution is None else [solution.assignment, *(other for other, _ in solution.alternatives)]
    named += [] if sampled.assignments is None else list(sampled.assignments)
    named += [] if sampled.consensus is None else [sampled.consensus]
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
    try:
        body = Candidate.of(task, named)
        (told,) = competing([body])
    except OutOfTime:
        return base
    return told_by(base, told, body, sampled.missed)


def told_by(base: Finding, told: Posterior, body: Candidate, missed: float = 0.0) -> Finding:
    """A finding with the assignment, its facts and its confidence as a posterior tells them.

    Parameters
    ----------
    base : Finding
        Of the same task.
    told : Posterior
    body : Candidate
        Of which it is one.
    missed : float
        Probability that a pose which explains as much was never met.
    """
    n, least, prior = base.task.shape[0], base.task.options.min_probability, body.model.prior
    if not len(told.probabilities):
        return replace(
            base,
            assignment=np.full(n, -1, np.int64),
            others=[],
            scores=None,
            facts=Facts(present=0.0, probability=0.0, lead=0.0, min_probability=least),
            confidence=np.full(n, told.clutter),
            log_odds=0.0,
        )
    every, modes = told.ranked(1 + TRUST.alternatives), told.modes
    first, probability, confidence = modes.assignments[0], told.probability, told.confidence
    others = [one for one in every if ((one >= 0) & (one != first)).any()]
    fault = Misfit.of(float(modes.squared[0]), round(float(modes.freedom[0])))
    predicted = isinstance(prior, Doubted)
    holds = isinstance(prior, Doubted) and bool(prior.holds(modes.rotation[:1], modes.position[:1])[0])
    sure = told.believed(least)
    enough = max(LEAST if holds else base.task.problem.minimal + 1, TRUST.kept * int(np.count_nonzero(first >= 0)))
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
    status = decide(facts)
    if status is Status.MATCHED and sure is not None and kept < np.count_nonzero(first >= 0):
        others, pose, each = every, float(told.probabilities[0]), confidence[sure >= 0]
        facts = replace(facts, probability=min(pose * float(np.prod(each / each.max())), float(each.min())))
        confidence = np.where((sure < 0) & (first >= 0), told.unmatched, confidence)
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
        prior_holds=holds if predicted and status is not Status.UNTRUSTED else None,
        fused_pose=_pose(body, told) if holds and status is not Status.UNTRUSTED else None,
    )


def _pose(body: Candidate, told: Posterior) -> Pose:
    """The pose of the first mode, of the points as they were given."""
    R, position, covariance = told.modes.rotation[0], told.modes.position[0], told.modes.covariance[0]
    arm = R @ body.model.centre
    from_centre = np.eye(6)
    from_centre[3:, :3] = cross_matrix(arm)
    return Pose.unchecked(R, position - arm, from_centre @ covariance @ from_centre.T)

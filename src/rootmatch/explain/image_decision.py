"""The judgement of findings by the model of the image: assignment, confidence, and the facts of a status.

One rule for every task with a pose of its camera, and for several bodies together: a body is trusted if its pose is
probable enough, without its doubtful matches. It is ambiguous if it is in view with that probability but its pose is
not certain. Otherwise nothing is trusted.
"""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from rootmatch.deadline import OutOfTime
from rootmatch.explain.continued_bodies import LIKELY, allow_continuations, continue_body
from rootmatch.explain.decide import TRUST, Facts, Status
from rootmatch.explain.finding import Finding, make_unjudged, mode_pose
from rootmatch.explain.goodness_of_fit import Misfit, discount_misfit, is_misfit
from rootmatch.explain.image_hypotheses import NAMED, Candidate
from rootmatch.explain.in_time import final_deadline
from rootmatch.explain.lacking_points import allow_lacking, lacking_points
from rootmatch.explain.line_in_common import log_odds_of_line
from rootmatch.explain.predicted_poses import polish_pose, select_prediction
from rootmatch.explain.rig_triples import is_met_by_search
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.zoom_hypotheses import has_image_model, make_candidate
from rootmatch.frozen import copy_with
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.model.blobs import likeliest_lit_points, swap_to_likeliest
from rootmatch.model.copy_or_alike import log_odds_of_points_elsewhere
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.elsewhere import log_odds_of_another
from rootmatch.model.evidence import residual_statistics, settle_poses
from rootmatch.model.image_alike import alike_log_odds
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import MINIMUM, Doubted
from rootmatch.model.posterior import Others, Posterior
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.model.shown_in_part import FewShown
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Solution

KEPT = 0.8
"""Part of its matches that has to remain of a trusted body: a pose that is certain with fewer is called ambiguous,
because too much of what it shows is unknown. A round value."""
UNSETTLED = 2.0
"""Squared residuals over degrees of freedom beyond which a mode is settled before they are told: at its best pose so
many are rare. A round value."""

BY_ITS_LAW = (
    "something with the same repeating pattern, such as another board with equal squares, explains more of the "
    "detections; give all such bodies with `bodies=`, or points that tell them apart"
)
BEYOND_DOUBT = 1e-6
"""Probability that there is no mode below which no confidence depends on why: a thousandth of `WRONG_MODEL`."""


def is_modelled(task: MatchingTask) -> bool:
    """Whether a task has a pose of its camera, in units of the noise: P3P, UP2P and UP2PF, and rigs."""
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    by_noise = (in_noise and not task.options.is_paper) or task.has_prior
    return by_noise and task.options.motions == 1 and has_image_model(task.problem)


def assess_image(
    task: MatchingTask, sampled: SampledTensor, solution: Solution | None = None, *, judging: bool = True
) -> Finding:
    """The finding of what a search or a solver proposed, judged by the model of the image.

    Unless ``judging``, what is proposed is left to whoever weighs it among more: `Finding.named`.
    """
    named, base = make_unjudged(task, sampled, solution)
    if not judging:
        with suppress(OutOfTime):
            if sampled.assignments is None:
                named[1:1] = make_candidate(task, []).gather_from_tensor(sampled.tensor)
        return copy_with(base, named=named)
    try:
        few = named if task.budget is None else named[:NAMED]
        body = make_candidate(task, few, sampled.tensor if sampled.assignments is None else None)
        told = body.alone()
    except OutOfTime:
        return base
    return image_finding(base, told, body, missed=sampled.missed)


def image_finding(
    base: Finding,
    told: Posterior,
    body: Candidate,
    *,
    missed: float = 0.0,
    missed_as_known: float = 0.0,
    taken: NDArray[np.bool_] | None = None,
    of_others: NDArray[np.bool_] | None = None,
    beside: bool = True,
) -> Finding:
    """A finding with the assignment, facts and confidence that a posterior of ``body`` gives.

    Parameters
    ----------
    base : Finding
        Of the same task.
    missed, missed_as_known : float
        Probability that a pose which explains as much was never met; and if the pose agrees with what was known before,
        as no search need meet what was predicted.
    taken, of_others : (n',) bool arrays, optional
        Detections of other bodies: the result is a mode without any of them, or nothing. Those that are explained by
        others, whether or not these are more certain.
    beside : bool
        Whether what is near points without a match counts.
    """
    shape = base.task.points.source, base.task.points.normals
    last, before, asked = final_deadline(), told, False
    with last.within():
        before = told = allow_lacking(told, body.model, lacking_points(*shape), of_others)
        told = allow_continuations(told, body.model, continue_body(*shape), of_others)
        asked = True
    if told.clutter - before.clutter > LIKELY:
        base = copy_with(base, reason=BY_ITS_LAW)
    elif base.reason == BY_ITS_LAW:
        base = copy_with(base, reason=None)
    model, modes, prior = body.model, told.modes, body.model.prior
    if base.task.weighs_parts:
        told = allow_few_shown(told, model, base, taken)
    free = (k for k, one in enumerate(modes.assignments) if taken is None or not taken[one[one >= 0]].any())
    minimum = base.task.options.required_probability
    scoreless = base.evaluated == 0
    k = next(free, None)
    present = told.present(k or 0)
    if k is None:
        nothing = np.full(base.task.rows, -1, np.int64)
        return copy_with(
            base,
            posterior=told,
            model=model,
            assignment=nothing,
            others=Others(told, TRUST.alternatives),
            facts=Facts(present=present, contested=True, min_probability=minimum, probability=0.0, lead=0.0),
            scores=None,
            scoreless=scoreless,
            confidence=None,
            log_odds=0.0,
            prior_holds=None,
            is_posed=False,
        )
    first, probability = modes.assignments[k], told.assignment_probability(modes.assignments[k])
    confidence = told.confidence if k == 0 else told.confidence_in(first)
    surest = likeliest_lit_points(model, first, (modes.rotation[k], modes.position[k]))
    if surest is not None:
        confidence, probability = confidence * surest[1], probability * float(surest[1].prod())
    fault = mode_misfit(model, modes, k)
    prediction = -1 if told.origins is None else int(told.origins[k])
    holds, matched = prediction >= 0, int(np.count_nonzero(first >= 0))
    if beside and present >= LIKELY:
        whole, asked, alike, another = asked, False, None, -math.inf
        with last.within():
            alike = alike_log_odds(model, modes, k, of_others)
            another = something_else_log_odds(model, told, k, of_others)
            asked = whole
        fault = fault._replace(alike=alike, another=another)
    # what there was no time to ask may be so
    missed = (missed_as_known if holds else missed) if asked else 1.0
    trusted = told.believe(minimum, 1.0 if surest is None else surest[1]) if k == 0 and missed <= TRUST.missed else None
    sure = None if trusted is None else trusted.assignment
    kept = 0 if sure is None else int(np.count_nonzero(sure >= 0))
    # otherwise no other pose with as few matches in each image would have been met
    met = sure is not None and is_met_by_search(base.task, model, sure)
    points = matched
    if base.task.rig is not None:  # which sees one several times
        points = int(np.count_nonzero((first.reshape(-1, base.task.shape[0]) >= 0).any(axis=0)))
    of_the_rest = (met or (holds and kept >= MINIMUM)) and trusted is not None and trusted.known >= KEPT * matched
    facts = Facts(
        present=present,
        contested=not of_the_rest,
        sure_of_the_rest=of_the_rest,
        min_probability=minimum,
        confirmed=points >= MINIMUM,
        false_alarms=math.inf if is_misfit(fault) else -math.inf,
        missed=missed if sure is None or met else 1.0,
    )
    if (status := facts.status) is Status.MATCHED and trusted is not None:
        probability = trusted.probability if kept < matched else max(probability, trusted.probability)
        confidence = np.where((trusted.assignment < 0) & (first >= 0), told.unmatched, confidence)
        first = trusted.assignment
    others, believed = Others(told, TRUST.alternatives, than=first), status is not Status.UNTRUSTED
    if surest is not None:
        first, confidence = swap_to_likeliest(first, confidence, surest[0])
    found = copy_with(
        base,
        posterior=told,
        model=model,
        task=select_prediction(base.task, prediction) if holds else base.task,
        assignment=first,
        others=others,
        facts=copy_with(facts, probability=probability, lead=odds_lead(probability) if scoreless else None),
        scores=None,
        scoreless=scoreless,
        soft=None if scoreless else base.soft,
        labels=None,
        confidence=confidence,
        log_odds=float(modes.log_odds[k]),
        noise_factor=fault.sigma,
        noise_dof=fault.dof,
        moved=fault.moved,
        alike=fault.alike,
        another=fault.another,
        mode=k,
        prior_holds=holds if believed and isinstance(prior, Doubted) else None,
        is_posed=believed,
    )
    if holds and isinstance(prior, Doubted) and prior.placed is not None:
        fault = fault._replace(another=-math.inf)  # frames tell that together
    return discount_misfit(found, fault, len(model.images) > 1)


def something_else_log_odds(
    model: DetectionModel, told: Posterior, k: int, of_others: NDArray[np.bool_] | None
) -> float:
    """Log-odds of something else with points elsewhere, or with a line in common, of the body in one of its modes.

    In one image not about a predicted pose: the body was there a moment ago.
    """
    if len(model.images) > 1:
        return log_odds_of_another(model, told.modes, k, of_others)
    if model.prior.minimum < MINIMUM and told.origins is not None and told.origins[k] >= 0:
        return -math.inf
    elsewhere = log_odds_of_points_elsewhere(model, told.modes, k, of_others)
    return float(np.logaddexp(elsewhere, log_odds_of_line(model, told.modes, k)))


def allow_few_shown(
    told: Posterior, model: DetectionModel, base: Finding, taken: NDArray[np.bool_] | None
) -> Posterior:
    """A posterior in which an image without a mode may also show the body: too little of it, or unmet by the search.

    Not about predicted poses, of which one or two matches are a mode.
    """
    minimum = model.prior.minimum
    if told.clutter < BEYOND_DOUBT or minimum < MINIMUM:
        return told
    maximum = minimum - 1 if isinstance(model.prior, Doubted) else max(base.task.minimal, minimum - 1)
    free = model.image_indices if taken is None else model.image_indices[~taken]
    counts = np.bincount(free, minlength=max(len(model.images), 1))
    return copy_with(told, few=FewShown(model, maximum, counts, base.unmet))


def odds_lead(probability: float | None) -> float:
    """The lead of an assignment without scores: 1 less the odds against it."""
    probability = probability or 0.0
    return max(1.0 - (1.0 - probability) / max(probability, 1e-300), 0.0)


def mode_misfit(model: DetectionModel, modes: Modes, k: int) -> Misfit:
    """Misfit of the detections about one of the modes; the deviation from a prediction does not count."""
    freedom = round(float(modes.freedom[k]))
    squared, moved = residual_statistics(model, modes.assignments[k], modes.rotation[k], modes.position[k])
    if squared > UNSETTLED * freedom:  # a mode that few steps led to may be far from its best pose
        own = slice(k, k + 1)
        _, at = settle_poses(model, modes.assignments[own], modes.rotation[own], modes.position[own])
        squared, _ = residual_statistics(model, modes.assignments[k], at.rotation[0], at.position[0])
    return Misfit.of(squared, freedom, moved)


def other_poses(found: Finding) -> list[tuple[Pose, float]]:
    """Other poses with the same matches, and their posterior probabilities, the most probable first.

    Those that are less probable than a wrong model are left out.
    """
    if found.posterior is None or found.model is None or found.pose is None:
        return []
    modes, chances, own = found.posterior.modes, found.posterior.probabilities, found.assignment >= 0
    same = (modes.assignments[:, own] == found.assignment[own]).all(axis=1)
    likely = np.flatnonzero(same & (chances >= WRONG_MODEL))
    out = []
    for k in likely[1:].tolist():
        pose = mode_pose(found.model, modes, k)
        out.append((polish_pose(copy_with(found, fitted=pose)) or pose, float(chances[k])))
    return out

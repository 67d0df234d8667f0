"""The assessment of a match of two point sets by the posterior of its labellings."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.backends import selection
from rootmatch.deadline import checkpoint
from rootmatch.errors import InputError
from rootmatch.explain.continued_bodies import LIKELY
from rootmatch.explain.continued_sets import allow_continued_sets
from rootmatch.explain.decide import TRUST, Facts, Status
from rootmatch.explain.finding import Finding, empty_tensor, make_unjudged
from rootmatch.explain.goodness_of_fit import MAX_ALIKE, Misfit, discount_misfit, is_misfit
from rootmatch.explain.image_decision import BY_ITS_LAW, odds_lead
from rootmatch.explain.in_time import final_deadline
from rootmatch.explain.predicted_pose import is_motion_search_needless, predicted_labellings
from rootmatch.explain.sampling import sample
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.deferred_tensor import DeferredTensor
from rootmatch.model.detection_model import HIGHEST_RATE
from rootmatch.model.motion_prior import MotionPrior, add_source_errors, fuse_with_known, motion_covariances
from rootmatch.model.near_symmetries import find_symmetries
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.point_set_off import log_odds_of_errors, log_odds_of_reflection
from rootmatch.model.point_set_posterior import PointSetPosterior, mix_posteriors, weigh_point_set_posterior
from rootmatch.model.priors import PRESENT
from rootmatch.model.repetition import Repeated, add_displaced, find_repetition
from rootmatch.model.weighed_labellings import NEGLIGIBLE
from rootmatch.problems.pose_fit.point_set_fit import FEWEST
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.samplers.base import SampledTensor
from rootmatch.samplers.point_sets.congruent import Labellings, congruent_labellings, grow_labellings, is_small
from rootmatch.solvers.base import Solution

LISTED, WEIGHED = 0.3, 0.035
"""Share of the time left at a deadline to list labellings, or all but so many seconds to weigh them."""
LEADING = 4
"""Number of labellings of a search to which the self-motions of the source are applied. A round value."""


def make_point_set_model(task: MatchingTask) -> PointSetModel | None:
    """The model of a task with two point sets of one space and one motion; None for any other task."""
    clouds = task.problem.point_clouds(task.points)
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    if clouds is None or not in_noise or task.options.motions != 1 or task.options.is_paper:
        if clouds is not None and task.has_prior:
            raise InputError("prior: it needs the model of a single motion; leave motions=, residual= and preset= out")
        return None
    rate = task.options.detection_rate
    return PointSetModel(
        clouds,
        mirror=bool(getattr(task.problem, "mirror", False)),
        allowed=task.allowed,
        log_weights=task.log_weights,
        detection_rate=None if rate is None else min(rate, HIGHEST_RATE),
        prior=_motion_prior(task),
        present=PRESENT if task.present is None else task.present,
    )


def _motion_prior(task: MatchingTask) -> MotionPrior | None:
    """What is known of a task's motion."""
    known = task.known if task.prior_pose is None else task.prior_pose
    if known is None:
        return None
    rest = 1.0 - sum(share for _, share in task.rivals.poses)
    return MotionPrior(((known, rest), *task.rivals.poses), task.rivals.doubt, task.prior_freedom)


def decide_point_sets(task: MatchingTask, judging: bool = True) -> Finding | None:
    """The finding of a task with default options; None if the model does not cover the task.

    Unless ``judging``, what a search proposes is left to whoever weighs it among more: `Finding.named`.
    """
    options = task.options
    model = make_point_set_model(task)
    default = options.chosen_sampler == "auto" and options.solver is None and options.scheduler is None
    if model is None or not default or options.backend in selection.ON_CARD:
        return None
    with task.deadline.enforce():
        checkpoint()
    if judging and (found := _judge_predicted(task, model)) is not None:
        return found
    return _search_labellings(task, model, [], judging)


def judge_one_motion(task: MatchingTask, named: Integers) -> Finding:
    """The finding of a part of a task that a packing took for one motion, with the labelling (n,) that it named."""
    model = make_point_set_model(task)
    assert model is not None
    return _search_labellings(task, model, [named])


def _search_labellings(
    task: MatchingTask, model: PointSetModel, named: list[Integers], judging: bool = True
) -> Finding:
    """The finding of what a search finds, and of named labellings: of all triples of small sets, where they are few."""
    labellings, judged = _list_labellings(task, model) if is_small(model.clouds) else None, None
    if labellings is not None and not labellings.cut:
        tensor = DeferredTensor.of(lambda: sample(task).tensor, task.shape, task.weights)
        sampled, every = SampledTensor(tensor, labellings.tried), labellings.proper
    else:
        sampled = sample(task)
        judged = judge_proposed(task, model, sampled, [*([] if labellings is None else labellings.proper), *named])
        every = judged.fit.assignments
    mirrored = None if labellings is None else labellings.mirrored
    if not judging:
        _, base = make_unjudged(task, sampled, None)
        return copy_with(base, named=list(every), mirrored=[] if mirrored is None else list(mirrored))
    return assess_labellings(
        task, model, sampled, judge_determined(model, every) if judged is None else judged, mirrored
    )


def judge_determined(model: PointSetModel, labellings: Integers) -> Judged:
    """Labellings (K, n), those that determine a motion."""
    return model.judge(labellings[(labellings >= 0).sum(axis=1) >= FEWEST])


def _judge_predicted(task: MatchingTask, model: PointSetModel) -> Finding | None:
    """The finding about predicted motions, if no other motion could explain more; None if a search has to tell."""
    named = [*predicted_labellings(model), *predicted_labellings(model, narrowed=True)]
    if not named:
        return None
    every = np.array(named)
    if not (every >= 0).all():
        every = grow_labellings(model.clouds, _add_symmetric(task, every), model.mirror, task.allowed)
    judged = model.judge(every)
    if not is_motion_search_needless(model, judged):
        return None
    # a part of the source that is like another one explains less, and tells nothing of where this one is
    alone = judged.log_odds - judged.known
    judged = judged.take(np.flatnonzero(alone > alone.max() - NEGLIGIBLE))
    found = assess_labellings(task, model, SampledTensor(empty_tensor(task), 0), judged)
    if found.status is not Status.MATCHED or not found.prior_holds:
        return None
    return copy_with(found.with_facts(lead=odds_lead(found.probability)), scoreless=True)


def _add_symmetric(task: MatchingTask, every: Integers) -> Integers:
    """Labellings (K, n), and those that self-motions of the source make of the first ones."""
    if task.points.source.shape[1] != 3:
        return every
    more = [
        np.where(symmetry.image >= 0, every[:LEADING, symmetry.image], -1)
        for symmetry in find_symmetries(task.points.source, None)
    ]
    return np.concatenate([every, *more])


def judge_solution(task: MatchingTask, solution: Solution, sampled: SampledTensor) -> Finding | None:
    """The finding for the result of a caller's own sampler or solver; None if the model does not cover the task."""
    model = make_point_set_model(task)
    if model is None:
        return None
    named = [solution.assignment, *(other for other, _ in solution.alternatives)]
    if not is_small(model.clouds):
        return assess_labellings(task, model, sampled, judge_proposed(task, model, sampled, named), soft=solution.soft)
    labellings = _list_labellings(task, model)
    judged = judge_determined(model, np.concatenate([named, labellings.proper]))
    return assess_labellings(task, model, sampled, judged, labellings.mirrored, soft=solution.soft)


def _list_labellings(task: MatchingTask, model: PointSetModel) -> Labellings:
    """All labellings of small sets, with time left to weigh them."""
    with task.deadline.part(LISTED, WEIGHED).enforce():
        return congruent_labellings(model.clouds, model.mirror, task.allowed)


def judge_proposed(task: MatchingTask, model: PointSetModel, sampled: SampledTensor, named: list[Integers]) -> Judged:
    """Labellings of large sets: those of a search, those that self-motions make of them, and named ones."""
    every = [*([] if sampled.assignments is None else sampled.assignments), *named]
    every += predicted_labellings(model)
    if not every:
        return judge_determined(model, np.empty((0, task.shape[0]), np.int64))
    return add_displaced(
        model,
        judge_determined(
            model, grow_labellings(model.clouds, _add_symmetric(task, np.array(every)), model.mirror, task.allowed)
        ),
    )


def assess_labellings(
    task: MatchingTask,
    model: PointSetModel,
    sampled: SampledTensor,
    judged: Judged,
    mirrored: Integers | None = None,
    soft: Floats | None = None,
) -> Finding:
    """The finding of proposed labellings; their scores are computed when they are asked for."""
    _, base = make_unjudged(task, sampled, None)
    base = copy_with(base, assignment=np.full(len(model.clouds.source), -1, np.int64), others=[], soft=soft)
    repeated = find_repetition(model, judged)
    every = [Repeated(model, judged, 0.0), *([] if repeated is None else [repeated])]
    found = [weigh_point_set_posterior(one.model, one.judged, mirrored) for one in every]
    beside, asked = found, False
    with final_deadline().within():
        beside = [allow_continued_sets(told, one.model) for told, one in zip(found, every, strict=True)]
        asked = True
    before, after = (
        [copy_with(told, log_total=told.log_total + one.log_odds) for told, one in zip(some, every, strict=True)]
        for some in (found, beside)
    )
    whole = mix_posteriors(after)
    if mix_posteriors(before).present - whole.present > LIKELY:
        base = copy_with(base, reason=BY_ITS_LAW)
    model = every[int(np.argmax([told.log_total for told in after]))].model
    return point_set_finding(base, whole, model, asked=asked)


def point_set_finding(
    base: Finding, found: PointSetPosterior, model: PointSetModel, taken: Bools | None = None, *, asked: bool
) -> Finding:
    """A finding with the assignment, facts and confidence that a posterior gives.

    ``base``: of the same task, with what its search may have missed. ``taken``: (n',) targets of other bodies, of which
    the labelling that is told has none. ``asked``: whether it was asked if something else that goes on by the body's
    law explains as much.
    """
    task, present, n = base.task, found.present, len(model.clouds.source)
    minimum = task.options.required_probability
    first = found if taken is None else found.without(taken)
    is_best = len(first.assignments) == 0 or bool((first.assignments[0] == found.assignments[0]).all())
    if not len(first.assignments):
        return copy_with(
            base,
            labellings=found,
            assignment=np.full(n, -1, np.int64),
            others=list(found.assignments[: TRUST.alternatives]),
            facts=Facts(
                present=present,
                probability=0.0 if len(found.assignments) else present,
                contested=len(found.assignments) > 0,
                lead=0.0,
                min_probability=minimum,
            ),
            scores=None if len(found.assignments) else [0.0],
            soft=np.zeros(task.shape),
            confidence=np.full(n, 1.0 - present if len(found.assignments) else 1.0),
            log_odds=0.0,
        )
    every, found = found, first
    assignment, probability = found.assignments[0], found.probability
    confidence, unmatched = found.confidence
    judged = model.judge_one(assignment)
    prior_holds = None if model.prior is None else bool(judged.held[0] >= 0)
    # a motion that is where it is known to be needs no search
    missed = 0.0 if prior_holds else base.facts.missed
    others = found.assignments[1:]
    sure = found.drop_doubtful(minimum) if missed <= TRUST.missed and is_best else None
    rest = judged if sure is None else model.judge_one(sure[0])
    min_set = int((rest.fit.assignments >= 0).sum()) <= FEWEST
    if rest is not judged and min_set and not rest.log_odds[0] > 0.0:
        sure = None  # of five matches three always fit somewhere: by themselves they have to be beyond chance
    if present >= minimum and sure is not None:
        left_out = (sure[0] < 0) & (assignment >= 0)
        if left_out.any():
            others = found.assignments
            judged = model.judge_one(sure[0])
            prior_holds = None if model.prior is None else bool(judged.held[0] >= 0)
        (assignment, probability), confidence = sure, np.where(left_out, unmatched, confidence)
    different = ((others >= 0) & (others != assignment)).any(axis=1)
    fault = Misfit.of(float(judged.fit.chi2[0]), int(judged.fit.dof[0]))
    told = copy_with(
        base,
        labellings=every,
        assignment=assignment,
        others=list(others[different][: TRUST.alternatives]),
        facts=Facts(
            present=present,
            probability=min(probability, present),
            lead=odds_lead(probability) if base.scoreless else None,
            min_probability=minimum,
            false_alarms=math.inf if is_misfit(fault) else -math.inf,
            missed=missed,
        ),
        scores=None,
        confidence=confidence,
        log_odds=float(model.judge_one(found.assignments[0]).log_odds[0]),
        noise_factor=fault.sigma,
        noise_dof=fault.dof,
        prior_holds=prior_holds,
        fitted=_fuse_prior(model, judged),
    )
    # what is left out as unsure may be what does not fit
    whole, in_time = fault, task.noise_is_estimated
    if not task.noise_is_estimated:
        with final_deadline().within():
            whole = _labelling_misfit(model, found, taken)
            in_time = asked
    certain = sure is not None and in_time
    facts = told.with_facts(contested=not certain, sure_of_the_rest=certain)
    told = copy_with(facts, alike=whole.alike, another=whole.another)
    if task.noise_is_estimated:
        return told
    if not prior_holds:
        whole = whole._replace(another=-math.inf)  # which the posterior has
    as_off = float(np.exp(np.minimum(whole.log_odds_of_errors(task.log_inexact), MAX_ALIKE)).sum())
    doubted = discount_misfit(told, whole, alike=model.clutter.repeats, as_off=as_off)
    # something is there that does not fit, which the advice says
    return doubted.with_facts(present=present) if is_misfit(fault) else doubted


def _labelling_misfit(model: PointSetModel, found: PointSetPosterior, taken: Bools | None) -> Misfit:
    """The misfit of the first hypothesis, by its residuals and by what is beside its points without a match."""
    first = found.assignments[0]
    whole = model.judge_one(first)
    fault = Misfit.of(float(whole.fit.chi2[0]), int(whole.fit.dof[0]))
    if (first >= 0).all():
        return fault
    log_mass = float(whole.log_odds[0]) + math.log(max(found.motion, 1e-300) / max(found.probabilities[0], 1e-300))
    # its mirror image was found where the body was expected, too
    fault = fault._replace(another=log_odds_of_reflection(model, first, log_mass - float(whole.known[0]), taken))
    if not found.present >= LIKELY:
        return fault
    return fault._replace(alike=log_odds_of_errors(model, first, log_mass, taken))


def _fuse_prior(model: PointSetModel, judged: Judged) -> Pose | None:
    """The pose of one labelling and of what is known of its motion, if that holds."""
    which = int(judged.held[0])
    if model.prior is None or which < 0:
        return None
    fit, known = judged.fit, model.prior.predictions[which][0]
    pose = Pose.unchecked(fit.rotation[0], fit.shift[0], motion_covariances(fit)[0], float(fit.scale[0]))
    return fuse_with_known(add_source_errors(model.clouds, fit.assignments[0], pose), known, model.prior.freedom)


def matches_pose(found: Finding) -> Pose | None:
    """The pose of a finding's matches alone."""
    (pose,) = found.task.problem.poses(found.task.points, found.assignment[None])
    clouds = found.task.problem.point_clouds(found.task.points)
    return pose if pose is None or clouds is None else add_source_errors(clouds, found.assignment, pose)

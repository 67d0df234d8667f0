"""`explain`: what a task's detections are, from the caller's points to a finding.

The route depends on what is known: a rig's cameras are searched one by one and verified together, several bodies are
explained in turn, a predicted pose narrows the candidates, and densities are aligned where detections are too dense for
minimal sets. Otherwise hyper-edges are sampled into a tensor, the tensor is solved and the solution assessed.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial

import numpy as np

from rootmatch.deadline import OutOfTime
from rootmatch.errors import InputWarning
from rootmatch.explain.assessment import assess
from rootmatch.explain.bodies import UNCONFIRMED, Choice, match_bodies
from rootmatch.explain.body_findings import find_no_body
from rootmatch.explain.dense_image import match_dense
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.image_bodies import match_bodies_in_image
from rootmatch.explain.image_decision import assess_image as judged_by_image
from rootmatch.explain.image_decision import is_modelled
from rootmatch.explain.imaged_calibration import ImagedCalibration
from rootmatch.explain.in_time import TOO_LATE, explain_in_time
from rootmatch.explain.inexact_points import allow_point_errors
from rootmatch.explain.judged_motions import find_motions_in_turn, judge_motions
from rootmatch.explain.known_pose import match_known
from rootmatch.explain.motion_groups import pack_motions
from rootmatch.explain.noise_estimation import estimate_noise_and_solve
from rootmatch.explain.point_set_decision import decide_point_sets, judge_solution, make_point_set_model
from rootmatch.explain.predicted_pose import match_predicted
from rootmatch.explain.proposed_pairs import find_pair_motions, is_worth_drawing
from rootmatch.explain.rig_search import match_rig
from rootmatch.explain.sampling import are_too_few, keep_affordable, make_sweep, sample
from rootmatch.explain.space_bodies import match_bodies_in_space
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.two_view_decision import assess_two_views as judged_by_views
from rootmatch.explain.two_view_decision import make_two_view_model as two_view_model
from rootmatch.explain.two_view_motions import match_motions
from rootmatch.explain.unseen_detections import explain_seen
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import Solution, solve_tensor

SOLVED = 0.6
"""Share of the time left at a deadline, after sampling, that the solver may take; the rest is for the assessment."""


def explain(task: MatchingTask, searching: bool | Choice = True) -> Finding:
    """The finding of a task; its noise is estimated first if requested.

    The assignments of a rig are of sightings, see `MatchingTask.rows`. Unless ``searching``, nothing is looked for
    elsewhere than about predicted poses; it may choose by what is found about those. Detections that a lens cannot show
    are left out.
    """
    _warn_of_idle_solver(task)
    return explain_seen(task, partial(explain_in_time, found=partial(_explain_searching, searching=searching)))


def _warn_of_idle_solver(task: MatchingTask) -> None:
    """Warn of a solver that was named and does not decide, as poses do; Python shows that once for each line."""
    if task.options.solver is None:
        return
    one = task.each_body[0]
    if is_modelled(one) or make_point_set_model(one) is not None:
        warnings.warn(
            f"solver: for {task.problem.name}, fitted poses decide; this solver only adds proposals, which rarely "
            'matter; to compare solvers give residual="qr" or preset="paper", or call them with a tensor',
            InputWarning,
            stacklevel=4,
        )


def _explain_searching(task: MatchingTask, searching: bool | Choice) -> Finding:
    """The finding of a task of which every detection can be seen, by predicted poses and searches."""
    if not searching:
        return _explain_predicted(task)
    if callable(searching):
        if task.bodies is not None and is_modelled(task.each_body[0]):
            return match_bodies_in_image(task, _propose, choice=searching)
        if task.prior_pose is not None:
            return match_predicted(task, _propose, searching)
        found = _explain_predicted(task)
        return found if (part := searching(found)) is None else _explain_in_time(part.of(task))
    return estimate_noise_and_solve(task, _explain_in_time) if task.estimates_noise else _explain_in_time(task)


def _explain_in_time(task: MatchingTask, judging: bool = True) -> Finding:
    """The finding of a task whose noise is known; an empty one if there is no time for anything.

    Unless ``judging``, that of a search for one motion is not judged: see `Finding.named`.
    """
    try:
        return _choose_route(task, judging)
    except OutOfTime:
        return find_no_body(task, TOO_LATE)


def _propose(task: MatchingTask) -> Finding:
    """What a search proposes to a route that weighs it together with more; judged, unless it has a budget."""
    return _explain_in_time(task, judging=task.budget is None)


def _propose_in_space(task: MatchingTask) -> Finding:
    """What the search for one of several bodies in space proposes."""
    try:
        return decide_point_sets(task, judging=False) or _explain_in_time(task)
    except OutOfTime:
        return make_empty_finding(task, None)


def _explain_predicted(task: MatchingTask) -> Finding:
    """What was found about predicted poses alone."""
    if task.bodies is None:
        return match_predicted(task, None) if task.known is None else match_known(task, None)
    return match_bodies_in_image(task, lambda part: make_empty_finding(part, UNCONFIRMED))


def _choose_route(task: MatchingTask, judging: bool) -> Finding:
    """The finding of a task whose noise is known, by the route that its other knowledge calls for."""
    if task.bodies is not None:
        if task.problem.takes_prior and is_modelled(task.each_body[0]):
            return match_bodies_in_image(task, _propose)
        if make_point_set_model(task.each_body[0]) is not None:
            return match_bodies_in_space(task, _propose_in_space)
        return match_bodies(task, _explain_in_time)
    of_camera = task.problem.takes_prior  # two point sets are weighed with all that is known, see `MotionPrior`
    if of_camera and task.known is not None:
        return match_known(task, lambda part: _explain_in_time(part, judging=False))
    if of_camera and task.prior_pose is not None:
        return match_predicted(task, _propose)
    if task.rig is not None:
        return match_rig(task, judging=judging or task.budget is None)
    if (decided := decide_point_sets(task)) is not None:
        return decided
    if (dense := match_dense(task)) is not None:
        return dense
    if are_too_few(task):
        told = (
            f"{task.shape[1]} detections are too few to tell a pose of {task.shape[0]} points from chance; "
            "give normals, a `prior`, or more detections"
        )
        return make_empty_finding(task, told).with_facts(missed=1.0)
    return _explain_motions(task) if task.options.packs_motions else _explain_motion(task, judging)


def _explain_motions(task: MatchingTask) -> Finding:
    """Groups of one motion each: among proposed pairs, which are evidence themselves, in turn, or packed and judged.

    The model of one motion finds each by itself, between two views always, and elsewhere if each shows enough. Small
    ones tell of each other in a packing alone, which evaluates all hyper-edges.
    """
    if two_view_model(replace(task, options=replace(task.options, motions=1))) is not None:
        return match_motions(task, _explain_in_time)
    if is_worth_drawing(task):
        return judge_motions(assess(task, *find_pair_motions(task)), proposed=True)
    # a caller's sampler is not gone beyond
    solve = _explain_in_time if task.options.chosen_sampler == "auto" else None
    if solve is not None and (found := find_motions_in_turn(task, solve)) is not None:
        return found
    sampled = sample(task)
    return judge_motions(assess(task, pack_motions(task, sampled), sampled), solve)


def _judge_image(task: MatchingTask, sampled: SampledTensor, solution: Solution | None, *, judging: bool) -> Finding:
    """What was sampled, judged by the model of an image; again by the calibration that it tells, if that is inexact."""
    found = judged_by_image(task, sampled, solution, judging=judging)
    told = ImagedCalibration.of(found) if judging else None
    if told is not None:
        named = found.assignment[None]
        if sampled.assignments is not None:
            named = np.concatenate([named, sampled.assignments])
        again = judged_by_image(told.task, sampled._replace(assignments=named), solution)
        again = allow_point_errors(again, told.task, missed=sampled.missed)
        if (better := told.better(again)) is not found:
            return better
    return allow_point_errors(found, task, missed=sampled.missed)


def _explain_motion(task: MatchingTask, judging: bool) -> Finding:
    """Sampled hyper-edges, solved and judged; all of them if a quick search finds no match to trust."""
    sampled = sample(task)
    by_image, views = is_modelled(task), two_view_model(task)
    modelled, named = by_image or views is not None, sampled.assignments
    solution = None
    if not modelled or named is None or not len(named) or task.options.solver is not None:
        deadline = task.deadline.part(SOLVED)
        solver = task.options.choose_solver(named is not None)
        solution = solve_tensor(solver, keep_affordable(sampled.tensor, deadline), task.options.seed, deadline)
    if by_image:
        found = _judge_image(task, sampled, solution, judging=judging)
    elif views is not None:
        found = judged_by_views(task, views, sampled, solution)
    else:
        assert solution is not None
        found = judge_solution(task, solution, sampled) or assess(task, solution, sampled)
    every = make_sweep(task, sampled)
    if by_image and not judging:
        return replace(found, left=every)
    if not found.status and every is not None:
        again = _explain_in_time(every)
        same = replace(task, points=again.task.points)  # which may be off though nobody said so
        return replace(again, task=same, evaluated=again.evaluated + sampled.evaluated)
    return found

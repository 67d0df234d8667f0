"""Matching where a pose is known in part: proposals that need no search, and searches that what is known narrows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.deadline import OutOfTime
from rootmatch.explain.body_findings import restore_columns
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.image_decision import image_finding
from rootmatch.explain.image_hypotheses import Candidate
from rootmatch.explain.in_time import prediction_deadline
from rootmatch.explain.known_place import Pairs, find_pairs_by_angle, propose_by_position
from rootmatch.explain.known_rotation import has_many_pairs, lines_of_sight, propose_by_rotation
from rootmatch.explain.predicted_poses import contradicts, pose_knowledge
from rootmatch.explain.prior_validation import DOUBT
from rootmatch.explain.sampling import are_too_few
from rootmatch.explain.task import MatchingTask
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.pose_density import Gaussian
from rootmatch.model.prediction import propose_about
from rootmatch.model.proposals import Proposals, join_proposals
from rootmatch.problems.pose_fit.pose_prior import PosePrior
from rootmatch.problems.pose_fit.reference_point import pose_about_point
from rootmatch.problems.up2p import UP2P
from rootmatch.samplers.guided.sampler import task_by_triples
from rootmatch.samplers.limits import LIMITS

SURE = 0.1
"""Standard deviation of a direction, in radians, up to which a search takes it for a vertical. A round value."""
QUICK = 8_000_000
"""Evaluations of that search: half a second. A round value."""
REACH = 4.0
"""Standard deviations of a position within which its detections are searched. A round value."""


def match_known(task: MatchingTask, solve: Callable[[MatchingTask], Finding] | None) -> Finding:
    """The match of a task of which the pose is known in part.

    What a known rotation or position proposes is weighed first; of many points, whose pairs are only drawn, after a
    short search, which mostly finds them in less time. Where that is not believed, the image is searched with what is
    known, then without it, as it may be wrong; without ``solve`` it is not searched. What is told is the posterior of
    everything that was proposed.
    """
    assert task.known is not None
    body, proposed, pairs = Candidate.of(task, []), None, None
    with prediction_deadline(task.deadline).within():
        pairs = find_pairs_by_angle(task, task.known)
    found = make_empty_finding(task, f"{task.shape[1]} detections are too few for a search")
    if pairs is None and solve is not None and task.budget is None and has_many_pairs(task):
        quick = _search_narrowed(replace(task, budget=QUICK), solve, body, found)
        if quick.status is Status.MATCHED:
            return replace(quick, task=task)
    with prediction_deadline(task.deadline).within():
        proposed = propose_by_knowledge(task, body.model, pairs)
        if proposed is not None:
            body = body.with_assignments([], proposed)
            found = image_finding(
                make_empty_finding(task, "the detections do not confirm what is known of the pose"), body.alone(), body
            )
            if found.status is Status.MATCHED:
                return replace(found, reason=None)
    if solve is None:
        return found
    return _search_narrowed(task, solve, body, found, proposed)


def _search_narrowed(
    task: MatchingTask,
    solve: Callable[[MatchingTask], Finding],
    body: Candidate,
    found: Finding,
    proposed: Proposals | None = None,
) -> Finding:
    """What searches find, weighed with what was ``proposed`` and told by ``found``.

    What one of them would have met was not missed. One that its budget ended has not looked beside what it found, where
    what is known may point to a copy of that.
    """
    named, evaluated, missed, beside = list[Integers](), 0, 1.0, False
    for one, columns in _search_tasks(task):
        # with what is known every pose was proposed: without it, what is known would have to be wrong
        if proposed is not None and one.problem is task.problem and are_too_few(one, math.log(DOUBT)):
            continue
        part: MatchingTask | None = one
        while part is not None and len(columns) >= part.problem.order and not task.deadline.passed():
            searched = solve(part)
            cut = part.budget is not None and searched.evaluated >= part.budget
            evaluated, part = evaluated + searched.evaluated, searched.left
            missed = min(missed, searched.facts.missed)
            searched = restore_columns(searched, task, columns)
            named += searched.named or searched.every
            with suppress(OutOfTime):
                body = body.with_assignments(named, proposed)
                base = replace(searched, task=task, evaluated=evaluated, named=(), left=None)
                # where all that is known leaves was proposed, a search need not meet it
                as_known = missed if proposed is None else 0.0
                found = image_finding(base, body.alone(), body, missed=missed, missed_as_known=as_known)
            if found.status is Status.MATCHED and not cut:
                if beside or not _is_elsewhere(found, task):
                    return found
                beside, free = True, np.flatnonzero(~np.isin(columns, found.assignment))
                part, columns = one.subset(np.arange(one.shape[0]), free), columns[free]
    return found


def _is_elsewhere(found: Finding, task: MatchingTask) -> bool:
    """Whether a body was found where what is known of it all but excludes it.

    It may be a copy: the body may be beside it, and show less.
    """
    assert task.known is not None
    return found.pose is not None and (not found.prior_holds or contradicts(task.known, found.pose))


def propose_by_knowledge(task: MatchingTask, model: DetectionModel, pairs: Pairs | None) -> Proposals | None:
    """What is assigned about the poses that a known rotation or position leaves, or both; None without any.

    ``pairs``: those of `find_pairs_by_angle`.
    """
    known = pose_knowledge(task)
    assert known is not None
    parts = [propose_by_rotation(task, known, model), propose_by_position(task, known, model, pairs)]
    if known.pose is not None:
        pose = known.pose
        assert pose.covariance is not None
        at_centre = pose_about_point(pose.R, pose.t, pose.covariance, model.centre)
        parts.append(propose_about(model, Gaussian(pose.R, *at_centre)))
    some = [part for part in parts if part is not None]
    return join_proposals(some) if some else None


def _search_tasks(task: MatchingTask) -> Iterator[tuple[MatchingTask, Integers]]:
    """Tasks that are searched one after another, and which detections they have: with what is known, and without it."""
    assert task.known is not None
    every = np.arange(task.shape[1])
    columns = select_near_position(task)
    narrowed = task if len(columns) == len(every) else task.subset(np.arange(task.shape[0]), columns)
    upright = _upright_problem(narrowed, task.known)
    if upright is not None:
        pairs = replace(narrowed, problem=upright, known=None)
        if task.budget is None and task_by_triples(pairs.sampling_task) is not None:
            # pairs would not be searched first either
            yield replace(narrowed, budget=LIMITS.quick, known=None), columns
        yield pairs, columns
    elif narrowed is not task:
        yield replace(narrowed, known=None), columns
    yield replace(task, known=None), every


def select_near_position(task: MatchingTask) -> Integers:
    """Detections whose lines of sight come so near to a known position that they may be of the body."""
    assert task.known is not None
    if task.known.place is None:
        return np.arange(task.shape[1])
    t, covariance = task.known.place
    origins, rays, _ = lines_of_sight(task)
    reach = float(np.linalg.norm(task.points.source, axis=1).max())
    reach += REACH * math.sqrt(float(np.linalg.eigvalsh(covariance)[-1]))
    along = ((t - origins) * rays).sum(axis=1)
    off = np.linalg.norm(t - origins - np.maximum(along, 0.0)[:, None] * rays, axis=1)
    return np.flatnonzero(off <= reach)


def _upright_problem(task: MatchingTask, known: PosePrior) -> UP2P | None:
    """`UP2P` of the same camera with a known direction for its vertical; None if none is known well enough."""
    problem = task.problem
    if known.down is None or known.down[2] > SURE or isinstance(problem, UP2P):
        return None
    source, vertical, noise = known.down
    return UP2P(problem.camera, tuple(vertical.tolist()), tuple(source.tolist()), noise)  # type: ignore[attr-defined]

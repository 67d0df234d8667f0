"""Several known rigid bodies in one image: each is matched by itself, and no detection is used twice.

Sure bodies go first. Each search that succeeds takes its detections away from those that follow, so that the bodies
which show little are searched for among few detections: short searches for all come before longer ones for those that
are left. A body that looks like another one, or like its mirror image, takes nothing before that other one was tried on
the same detections.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import UnseenPixelError
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.on_demand import changed
from rootmatch.pipeline.assessment import fits
from rootmatch.pipeline.body_labels import Label
from rootmatch.pipeline.body_options import OPTIONS, BodyOptions
from rootmatch.pipeline.detection_odds import DEFAULT_OPTIONS
from rootmatch.pipeline.point_set_decision import lead_over_others
from rootmatch.pipeline.posterior import ranked
from rootmatch.pipeline.rig_task import RigCopies, twin_of
from rootmatch.pipeline.status import TRUST, Status
from rootmatch.pipeline.task import MatchingTask
from rootmatch.predicted import direct_match, empty_match
from rootmatch.result import Match
from rootmatch.samplers.guided.sampler import Guided, pays

Integers = NDArray[np.int64]
Solve = Callable[[MatchingTask], Match]
BODY = 0.5
"""Share of the time left at a deadline for the search for one body."""
LISTED = 5
"""Alternatives of a doubtful match that another body may rule out by taking their detections. A round value."""
AS_GIVEN = replace(DEFAULT_OPTIONS, rounds=0)
"""No neighbours of assignments are looked at."""
ORDER = (Status.MATCHED, Status.AMBIGUOUS, Status.UNTRUSTED)
"""Statuses in the order in which bodies that are not sure get their detections."""


@dataclass(eq=False)
class _Body:
    """One body in the course of the search."""

    number: int
    label: Label
    points: Integers
    match: Match | None = None
    """Of its points, all detections and −1 where unmatched."""
    settled: bool = False
    budget: int = 0
    """Of the last search for it."""
    cut: bool = False
    """Whether that ended by its budget."""
    among: int = 0
    """Free detections at that search."""

    @property
    def detections(self) -> Integers:
        """Those that its assignment uses."""
        assert self.match is not None
        return self.match.assignment[self.match.assignment >= 0]

    @property
    def probability(self) -> float:
        """Of its assignment, as far as the status needed it; 1 where a clear one needed none."""
        assert self.match is not None
        known = self.match.fitted_probability
        return 1.0 if known is None else known

    def worth_a_search(self, free: NDArray[np.bool_], budget: int) -> bool:
        """Whether a search among the free detections with such a budget may find what the last one did not."""
        if self.settled:
            return False
        if self.match is None:
            return True
        fewer = int(free.sum()) < self.among
        if self.cut:
            doubt = self.match.status is Status.AMBIGUOUS and self.probability < TRUST.probability
            return fewer or (budget > self.budget and not doubt)
        if self.match.status is Status.UNTRUSTED:
            return fewer
        listed = [self.match.assignment, *(other for other, _ in self.match.alternatives[:LISTED])]
        return fewer and not all(free[one[one >= 0]].all() for one in listed)


def match_bodies(task: MatchingTask, solve: Solve, options: BodyOptions = OPTIONS) -> Match:
    """The match of a task whose source points are of several bodies.

    Parameters
    ----------
    task : MatchingTask
        With labels.
    solve : callable
        From the task of one body to its match.
    options : BodyOptions
    """
    assert task.bodies is not None
    bodies = [_Body(k, label, task.bodies.points_of(k)) for k, label in enumerate(task.bodies.names)]
    free = np.ones(task.shape[1], np.bool_)
    first = options.first_budget if task.points.normals is not None else options.first_budget_without_normals
    budgets = [int(first * options.budget_growth**k) for k in range(options.rounds)]
    evaluated = 0
    for sure in (options.sure, TRUST.probability):  # the surest first: what is left is clearer without their detections
        for body in bodies:
            _predict(task, body, free, sure)
    for body in bodies:
        body.among = int(free.sum())  # what was predicted with more of them is no worse for that
    for turn in count():
        budget = budgets[min(turn, options.rounds - 1)]
        searched = False
        for body in bodies:
            if not body.worth_a_search(free, budget):
                continue
            searched = True
            before = body.match
            body.match, body.cut = _searched(task, body, np.flatnonzero(free), budget, solve)
            _keep_trusted(body, before)
            body.budget, body.among = budget, int(free.sum())
            evaluated += body.match.hyperedges + _confirm(task, body, solve, options)
            if body.match.status is Status.MATCHED:
                _check_rivals(
                    task, body, [other for other in bodies if not other.settled and other is not body], options
                )
            if body.match.status is Status.MATCHED and body.probability >= options.sure:
                body.settled = True
                free[body.detections] = False
        if (not searched and turn + 1 >= options.rounds) or task.deadline.passed():
            break
    _make_exclusive(task, bodies, free, solve, budgets[-1])
    return _joined(task, bodies, evaluated)


def _predict(task: MatchingTask, body: _Body, free: NDArray[np.bool_], sure: float) -> None:
    """Match a body by its predicted pose among the free detections, and settle it where that is sure enough.

    What is believed but in doubt stays, as no search would know more.
    """
    part = task.body(body.number)
    if body.settled or part.predicted is None or not free.any():
        return
    columns = np.flatnonzero(free)
    sub = replace(part.subset(np.arange(len(part.points.source)), columns), predicted=part.predicted)
    found = direct_match(sub)
    if found is None:
        return
    body.match = _widened(found, part, columns)
    if found.status is Status.MATCHED and (found.probability or 0.0) >= sure:
        body.settled = True
        free[body.detections] = False


def _searched(task: MatchingTask, body: _Body, columns: Integers, budget: int, solve: Solve) -> tuple[Match, bool]:
    """The match of one body among some detections, its indices those of all, and whether the budget ended the search.

    A sampler that the caller gave has a budget of its own, or none.
    """
    part = task.body(body.number)
    if task.deadline.passed():
        return empty_match(part, "max_seconds were over before it was searched for"), False
    part = replace(part, deadline=task.deadline.part(BODY))
    if len(columns) < task.problem.order:
        fault = f"{len(columns)} detections are left, at least {task.problem.order} needed"
        return empty_match(part, fault), False
    sub = part.subset(np.arange(len(body.points)), columns)
    try:
        of_rig = isinstance(sub.problem, RigCopies)
        bounded = sub.options.sampler == "auto" and sub.options.scheduler is None
        bounded = bounded and (of_rig or pays(sub.sampling_task))
        if bounded:
            sub = replace(sub, options=replace(sub.options, hyperedges=Guided(budget=budget)))
        found = solve(sub)
    except UnseenPixelError as error:
        if not task.predicted_bodies:
            raise
        return empty_match(part, str(error)), False  # the bodies whose pose is predicted need no rays
    # a rig has a budget for each camera
    ended = not found.converged if of_rig else found.hyperedges >= budget
    return _widened(found, part, columns), bounded and ended


def _keep_trusted(body: _Body, before: Match | None) -> None:
    """Leave a match ambiguous that was so among more detections.

    Those of other bodies are gone; what was beyond chance among them is no accident without them, though it looks like
    a larger share of what is left.
    """
    if before is None or body.match is None or before.status is not Status.AMBIGUOUS:
        return
    if body.match.status is Status.UNTRUSTED and np.array_equal(before.assignment, body.match.assignment):
        body.match = changed(body.match, status=Status.AMBIGUOUS)


def _confirm(task: MatchingTask, body: _Body, solve: Solve, options: BodyOptions) -> int:
    """Match a sure body whose search was cut short before it looked for other poses with the same detections.

    Elsewhere are other bodies, but these detections have one owner: they alone are searched. Returns the evaluations.
    """
    found = body.match
    assert found is not None
    sure = found.status is Status.AMBIGUOUS and body.probability >= options.sure
    if not (sure and body.cut and len(body.detections) >= options.confirmed):
        return 0
    again, _ = _searched(task, body, np.sort(body.detections), body.budget, solve)
    if again.status is Status.MATCHED and np.array_equal(again.assignment, found.assignment):
        body.match = changed(found, status=Status.MATCHED)
    return again.hyperedges


def _check_rivals(task: MatchingTask, body: _Body, others: list[_Body], options: BodyOptions) -> None:
    """Call a body's match ambiguous where one that looks alike explains its detections nearly as well.

    A mirror image of a body, its depth reversed, has the same image but for perspective; normals tell them apart.
    """
    assert body.match is not None
    own, least = task.body(body.number), math.log(1.0 / options.doubt - 1.0)
    rivals = [task.body(other.number) for other in others]
    if (lead := lead_over_others(own, body.match.assignment, rivals)) is not None:
        if lead < least:
            body.match = changed(body.match, status=Status.AMBIGUOUS, **_shared(body, lead))
        return
    if not fits(own, body.match.assignment):
        return
    here = None
    for other in others:
        theirs = task.body(other.number)
        twin = twin_of(own, theirs, options.alike)
        if twin is None:
            continue
        here = here or ranked(own, [body.match.assignment], AS_GIVEN)
        assignment = np.full(len(other.points), -1, np.int64)
        assignment[twin] = body.match.assignment
        lead = here.beyond_chance - ranked(theirs, [assignment], AS_GIVEN).beyond_chance
        if lead < least:
            body.match = changed(body.match, status=Status.AMBIGUOUS, **_shared(body, lead))


def _shared(body: _Body, lead: float) -> dict[str, Any]:
    """What is left of a body's probability and confidence where it has such odds against another on its detections."""
    assert body.match is not None
    share = 1.0 / (1.0 + math.exp(min(-lead, 700.0)))
    known = body.match.fitted_confidence
    each = {} if known is None else {"fitted_confidence": known * np.where(body.match.assignment >= 0, share, 1.0)}
    return {"fitted_probability": body.probability * share, **each}


def _make_exclusive(
    task: MatchingTask, bodies: list[_Body], free: NDArray[np.bool_], solve: Solve, budget: int
) -> None:
    """Give the free detections to the bodies that are not sure, those first whose matches are least likely chance."""
    waiting = [body for body in bodies if not body.settled]
    _contest(waiting)
    evidence = {body.number: _evidence(task, body) for body in waiting}
    doubtful = np.zeros(task.shape[1], np.bool_)  # taken by a body that may as well be elsewhere
    while waiting:
        waiting.sort(key=lambda body: (ORDER.index(body.match.status), -evidence[body.number]))  # type: ignore[union-attr]
        body = waiting.pop(0)
        if not free[body.detections].all():
            contested = doubtful[body.detections].any()
            body.match, _ = _searched(task, body, np.flatnonzero(free), budget, solve)
            if contested and body.match.status is Status.MATCHED:
                body.match = changed(body.match, status=Status.AMBIGUOUS, **_shared(body, 0.0))
        free[body.detections] = False
        if body.match.status is Status.AMBIGUOUS:
            doubtful[body.detections] = True


def _contest(waiting: list[_Body]) -> None:
    """Call matches ambiguous whose detections another body may have as well, as none of them is sure."""
    trusted = [body for body in waiting if body.match is not None and body.match.status is not Status.UNTRUSTED]
    used = [body.detections for body in trusted]
    for k, body in enumerate(trusted):
        assert body.match is not None
        rivals = np.concatenate([*used[:k], *used[k + 1 :], np.empty(0, np.int64)])
        if body.match.status is Status.MATCHED and np.isin(body.detections, rivals).any():
            body.match = changed(body.match, status=Status.AMBIGUOUS)


def _evidence(task: MatchingTask, body: _Body) -> float:
    """Log-odds of a body's matches against all detections being clutter; −∞ where they have none."""
    assert body.match is not None
    own = task.body(body.number)
    if not fits(own, body.match.assignment):
        return -math.inf
    found = ranked(own, [body.match.assignment], AS_GIVEN).beyond_chance
    return found if math.isfinite(found) else -math.inf


def _joined(task: MatchingTask, bodies: list[_Body], evaluated: int) -> Match:
    """One match of all bodies: the sum of their scores, the least of what each may be trusted."""
    n, n_target = task.shape
    assignment, motions = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    soft = np.zeros((n, n_target))
    indices, weights = [], []
    matches: dict[Label, Match] = {}
    for k, body in enumerate(bodies):
        found = body.match
        assert found is not None
        matches[body.label] = found
        assignment[body.points] = found.assignment
        motions[body.points] = np.where(found.assignment >= 0, k, -1)
        soft[body.points] = found.soft
        i, j = np.divmod(found.tensor.indices.astype(np.int64), n_target)
        indices.append((body.points[i] * n_target + j).astype(np.int32))
        weights.append(np.asarray(found.tensor.weights))
    every = list(matches.values())
    statuses = [found.status for found in every]
    worst = next(one for one in (Status.UNTRUSTED, Status.AMBIGUOUS, Status.MATCHED) if one in statuses)
    return Match(
        task=task,
        assignment=assignment,
        score=float(sum(found.score for found in every)),
        margin=min(found.margin for found in every),
        alternatives=[],
        soft=soft,
        tensor=AffinityTensor.unchecked(np.concatenate(indices), np.concatenate(weights), task.shape, task.prior),
        motions=motions,
        status=worst,
        converged=all(found.converged for found in every),
        hyperedges=evaluated,
        seconds=0.0,
        bodies=matches,
    )


def _widened(found: Match, task: MatchingTask, columns: Integers) -> Match:
    """A match among some detections as one among all of them."""
    n, n_target = task.shape
    i, j = np.divmod(found.tensor.indices, np.int32(len(columns)))
    indices = (i * np.int32(n_target) + columns.astype(np.int32)[j]).astype(np.int32)
    soft = np.zeros((n, n_target))
    soft[:, columns] = found.soft

    def of_all(assignment: Integers) -> Integers:
        return np.where(assignment >= 0, columns[assignment], -1)

    return replace(
        found,
        task=replace(task, noise=found.task.noise),
        assignment=of_all(found.assignment),
        alternatives=[(of_all(other), score) for other, score in found.alternatives],
        soft=soft,
        tensor=AffinityTensor.unchecked(indices, np.asarray(found.tensor.weights), (n, n_target), task.prior),
    )

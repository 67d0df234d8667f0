"""Several known rigid bodies of a problem without a model of all observations: matched one after another.

Certain bodies go first; no detection is used twice. A successful search removes its detections from the later ones, so
bodies that show little are searched for among few detections: short searches for all bodies come before longer ones for
the rest. `rootmatch.explain.image_bodies` and `rootmatch.explain.space_bodies` weigh bodies together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from typing import NamedTuple, TypeVar

import numpy as np

from rootmatch.arrays import Bools, Integers
from rootmatch.deadline import OutOfTime
from rootmatch.errors import UnseenPixelError
from rootmatch.explain.body_findings import join_findings, restore_columns
from rootmatch.explain.decide import MIN_PROBABILITY, Status
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.posterior import Posterior
from rootmatch.model.prediction import COMPLETE
from rootmatch.samplers.guided.sampler import pays

Solve = Callable[[MatchingTask], Finding]
Body = TypeVar("Body")
FIRST_BUDGET, FIRST_BUDGET_WITHOUT_NORMALS = 200_000, 600_000
"""Evaluations of the first search for each body, and if normals do not tell which points are visible together: enough
for most bodies that show much. On tuning seeds (benchmarks/bodies.py) the first finds as many as 400,000 or 3,000,000
do, in less time."""
BUDGET_GROWTH, ROUNDS = 3.0, 4
"""Factor from one round of searches to the next, and the largest number of rounds in which it grows. Round values."""
SURE = 0.98
"""Probability from which a body takes its detections before the others are known."""
BODY = 0.5
"""Share of the time left at a deadline for the search for one body."""
BODY_OF_FRAME = 0.7
"""The same of a tracker's frame, which searches for one."""
LATE = "`max_seconds` ran out before this body was searched for"
UNCONFIRMED = "the detections do not confirm the predicted pose"
UNSEARCHED = "no pose was predicted, and this frame was not searched"
LISTED = 5
"""Number of alternatives of a doubtful match that another body may rule out by taking their detections. A round
value."""
ORDER = (Status.MATCHED, Status.AMBIGUOUS, Status.UNTRUSTED)
"""Statuses in the order in which uncertain bodies get their detections."""


class SearchPart(NamedTuple):
    """The part of a search that one frame takes."""

    body: int
    camera: int | None = None
    """Of a rig; None for one image. A single body is searched for in all."""
    rest: bool = False
    """Whether among those detections only that its prediction leaves."""
    share: float = 1.0
    """Share of its budget that it may take."""
    tried: tuple[int, ...] = ()
    """Other bodies on whose detections this one was tried before; what they certainly have is left out."""

    def of(self, task: MatchingTask) -> MatchingTask:
        """The part of a task."""
        budget = None if task.budget is None else round(self.share * task.budget)
        return copy_with(task, search_camera=self.camera, budget=budget)


Choice = Callable[[Finding], SearchPart | None]
"""Says what to search, None for nothing, given the finding about predicted poses."""


def is_mostly_shown(told: Posterior, mode: int = 0) -> bool:
    """Whether a body has detections for most of the points that are visible in one of its poses."""
    if len(told.probabilities) <= mode:
        return False
    matched = np.count_nonzero(told.modes.assignments[mode] >= 0)
    return bool(matched >= COMPLETE * float(told.modes.visible[mode].sum()))


@dataclass(eq=False, kw_only=True)
class SearchedBody:
    """One body in the course of the search."""

    number: int
    task: MatchingTask
    """Of its points and all detections."""
    found: Finding
    """Of its last search, or of its prediction."""
    settled: bool = False
    budget: int = 0
    """Of the last search for it."""
    cut: bool = False
    """Whether that ended by its budget."""
    among: int = -1
    """Number of free detections at that search; −1 before the first."""
    evaluated: int = 0
    """Evaluations of all its searches."""

    def search_among(self, task: MatchingTask, free: Bools, solve: Solve, budget: int) -> None:
        """Search among the free detections (n',) of the task of all bodies."""
        self.budget, self.among = budget, int(free.sum())
        self.found, self.cut = search_body_among(task, self.number, np.flatnonzero(free), budget, solve)
        self.evaluated += self.found.evaluated


class _Body(SearchedBody):
    """A body whose findings are matches, each judged by itself."""

    @property
    def detections(self) -> Integers:
        """Detections that its assignment uses."""
        return self.found.assignment[self.found.assignment >= 0]

    @property
    def probability(self) -> float:
        """Probability of its assignment; 1 for a clear one whose status needed none."""
        return 1.0 if self.found.probability is None else self.found.probability

    @property
    def evidence(self) -> float:
        """Log-odds of its matches against all detections being clutter; −∞ where they have none."""
        found = self.found.log_odds
        return found if found is not None and math.isfinite(found) else -math.inf

    def is_worth_searching(self, free: Bools, budget: int) -> bool:
        """Whether another search among the free detections, with this budget, may find more than the last one."""
        if self.settled:
            return False
        if self.among < 0:
            return True
        fewer = int(free.sum()) < self.among
        if self.cut:
            doubt = self.found.status is Status.AMBIGUOUS and self.probability < MIN_PROBABILITY
            return fewer or (budget > self.budget and not doubt)
        if self.found.status is Status.UNTRUSTED:
            return fewer
        listed = self.found.every[: 1 + LISTED]
        return fewer and not all(free[one[one >= 0]].all() for one in listed)


def why_unsearched(part: MatchingTask) -> str:
    """Why nothing is found of the body of a task that no search has come to."""
    if part.deadline.stopped_early:
        return LATE
    return UNSEARCHED if part.prior_pose is None else UNCONFIRMED


def match_bodies(task: MatchingTask, solve: Solve) -> Finding:
    """The match of a task whose source points are of several bodies; ``solve`` matches one of them."""
    bodies = [_Body(number=k, task=own, found=make_empty_finding(own, LATE)) for k, own in enumerate(task.each_body)]
    free = np.ones(task.shape[1], np.bool_)

    def search(body: _Body, budget: int) -> None:
        body.search_among(task, free, solve, budget)
        if body.found.status is Status.MATCHED and body.probability >= SURE:
            body.settled = True
            free[body.detections] = False

    with suppress(OutOfTime):
        search_rounds(task, bodies, lambda body, budget: body.is_worth_searching(free, budget), search)
        _make_exclusive(task, bodies, free, solve, search_budgets(task)[-1])
    return join_findings(task, [body.found for body in bodies], sum(body.evaluated for body in bodies))


def search_budgets(task: MatchingTask) -> list[int]:
    """Evaluations of the searches for a body, round after round."""
    first = FIRST_BUDGET if task.points.normals is not None else FIRST_BUDGET_WITHOUT_NORMALS
    return [int(first * BUDGET_GROWTH**k) for k in range(ROUNDS)]


def search_order(task: MatchingTask, bodies: Sequence[Body]) -> Sequence[Body]:
    """Bodies in the order in which they are looked for: with limited time, another one first after a frame cut short.

    Its seed is another one, too: see `rootmatch.tracking.search_schedule.reorder_draws`.
    """
    first = task.options.seed % len(bodies) if task.deadline.is_set else 0
    return [*bodies[first:], *bodies[:first]]


def search_rounds(
    task: MatchingTask, bodies: Sequence[Body], worth: Callable[[Body, int], bool], search: Callable[[Body, int], None]
) -> None:
    """Search for each body with growing budgets, wherever that is ``worth`` it, until nothing more can be expected."""
    budgets = search_budgets(task)
    for turn in count():
        budget = budgets[min(turn, ROUNDS - 1)]
        searched = False
        for body in search_order(task, bodies):
            if worth(body, budget):
                if task.deadline.passed():
                    return
                searched = True
                search(body, budget)
        if (not searched and turn + 1 >= ROUNDS) or task.deadline.passed():
            break


def search_body_among(
    task: MatchingTask, number: int, columns: Integers, budget: int, solve: Solve
) -> tuple[Finding, bool]:
    """The match of one body among some detections, its indices those of all, and whether the budget ended the search.

    A sampler that the caller gave has a budget of its own, or none.
    """
    part = task.each_body[number]
    if task.deadline.passed():
        return make_empty_finding(part, LATE), False
    part = copy_with(part, deadline=task.deadline.part(BODY if task.budget is None else BODY_OF_FRAME))
    if len(columns) < task.problem.order:
        fault = f"{len(columns)} detections are left, but at least {task.problem.order} are needed"
        return make_empty_finding(part, fault), False
    sub = part.subset(None, columns)
    if task.problem.takes_motion_prior:
        sub = copy_with(sub, prior_pose=part.prior_pose, rivals=part.rivals)
    try:
        of_rig = sub.rig is not None
        bounded = sub.budget is None and sub.options.chosen_sampler == "auto" and sub.options.scheduler is None
        bounded = bounded and (of_rig or pays(sub.sampling_task))
        if bounded:
            sub = copy_with(sub, budget=budget)
        found = solve(sub)
    except UnseenPixelError as error:
        if not task.is_predicted:
            raise
        return make_empty_finding(part, str(error)), False  # the bodies whose pose is predicted need no rays
    # a rig has a budget for each camera
    ended = not found.converged if of_rig else found.evaluated >= budget
    return restore_columns(found, part, columns), bounded and ended


def _share_detections(body: _Body) -> Finding:
    """A body's match made ambiguous by another body on its detections, which are as probably of either."""
    found, confidence = body.found, body.found.confidence
    if confidence is not None:
        confidence = confidence * np.where(found.assignment >= 0, 0.5, 1.0)
    return replace(found.with_facts(contested=True, probability=0.5 * body.probability), confidence=confidence)


def _make_exclusive(task: MatchingTask, bodies: list[_Body], free: Bools, solve: Solve, budget: int) -> None:
    """Give the free detections to the uncertain bodies, first to those whose matches are least likely to be chance."""
    waiting = [body for body in bodies if not body.settled]
    _contest(waiting)
    evidence = {body.number: body.evidence for body in waiting}
    doubtful = np.zeros(task.shape[1], np.bool_)  # taken by a body that may also be elsewhere
    while waiting:
        waiting.sort(key=lambda body: (ORDER.index(body.found.status), -evidence[body.number]))
        body = waiting.pop(0)
        if not free[body.detections].all():
            contested = doubtful[body.detections].any()
            body.found, _ = search_body_among(task, body.number, np.flatnonzero(free), budget, solve)
            if contested and body.found.status is Status.MATCHED:
                body.found = _share_detections(body)
        free[body.detections] = False
        if body.found.status is Status.AMBIGUOUS:
            doubtful[body.detections] = True


def _contest(waiting: list[_Body]) -> None:
    """Call matches ambiguous if another uncertain body may own their detections as well."""
    trusted = [body for body in waiting if body.found.status is not Status.UNTRUSTED]
    used = [body.detections for body in trusted]
    for k, body in enumerate(trusted):
        rivals = np.concatenate([*used[:k], *used[k + 1 :], np.empty(0, np.int64)])
        if body.found.status is Status.MATCHED and np.isin(body.detections, rivals).any():
            body.found = body.found.with_facts(contested=True)

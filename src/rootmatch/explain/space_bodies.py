"""Several known rigid bodies among points of a space: searched for one by one, and weighed together.

As `rootmatch.explain.image_bodies` does in an image: targets that are certainly of some body are left out of the
searches for others, no body takes targets before all others have been tried on them, and the result is the posterior
over everything that any of the searches proposed.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from rootmatch.arrays import Bools, Integers
from rootmatch.deadline import OutOfTime, checkpoint
from rootmatch.explain.bodies import LATE, SURE, SearchedBody, Solve, search_rounds
from rootmatch.explain.body_findings import join_findings
from rootmatch.explain.body_labels import is_same_body
from rootmatch.explain.continued_bodies import LIKELY
from rootmatch.explain.continued_sets import allow_continued_sets
from rootmatch.explain.finding import Finding, empty_tensor, make_empty_finding, make_unjudged
from rootmatch.explain.image_decision import BY_ITS_LAW
from rootmatch.explain.in_time import final_deadline, prediction_deadline
from rootmatch.explain.point_set_decision import (
    judge_determined,
    make_point_set_model,
    point_set_finding,
)
from rootmatch.explain.predicted_pose import is_motion_search_needless, predicted_labellings
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.modes import used_mask
from rootmatch.model.point_set_bodies import joint_posterior, judge_jointly
from rootmatch.model.point_set_model import Judged, PointSetModel
from rootmatch.model.point_set_posterior import PointSetPosterior
from rootmatch.model.weighed_labellings import Weighed, empty_weighed, weigh_labellings
from rootmatch.samplers.base import SampledTensor

SEARCHED = 0.8
"""Share of the time left at a deadline for the searches: all are weighed together after them. A round value."""


@dataclass(eq=False, kw_only=True)
class _Body(SearchedBody):
    """A body of which everything that was proposed is weighed with all others."""

    model: PointSetModel
    weighed: Weighed
    told: PointSetPosterior
    free: Bools
    """Targets among which it may still be found."""
    named: list[Integers] = field(default_factory=list)
    """What its prediction and its searches proposed."""
    copies: int = 1
    """Number of bodies that are the same as it, with itself."""
    predicted: Integers | None = None
    """The best labelling where it was predicted, if no other motion could explain more."""
    enough: bool = False
    """Whether it is where it was predicted, and needs no search."""

    def is_worth_searching(self, budget: int) -> bool:
        """Whether another search among the free targets, with this budget, may find more than the last one."""
        if self.settled:
            return False
        fewer = int(self.free.sum()) < self.among
        left = not len(self.told.assignments) or not (self.told.used(len(self.free)) * self.free).any()
        return self.among < 0 or (self.cut and (fewer or budget > self.budget)) or (fewer and left)

    def predict(self, named: list[Integers], judged: Judged) -> None:
        """Add what is where the body is predicted, and its neighbours."""
        self.named, self.predicted = named, judged.fit.assignments[int(judged.log_odds.argmax())]
        _, base = make_unjudged(self.task, SampledTensor(empty_tensor(self.task), 0), None)
        self.found = copy_with(base, scoreless=True)
        self.weighed = weigh_labellings(self.model, judged, of_several=True)

    @property
    def is_as_predicted(self) -> bool:
        """Whether it is surely as it was predicted, also among the others."""
        return self.told.motion >= SURE and bool((self.told.assignments[0] == self.predicted).all())

    def beside(self) -> PointSetPosterior | None:
        """What is told of it, where its law may go on in the targets that the others leave; None if time is over."""
        if not len(self.told.assignments):
            return self.told
        with final_deadline().within():
            first = float(self.model.judge_one(self.told.assignments[0]).log_odds[0])
            log_total = first - math.log(max(float(self.told.probabilities[0]), 1e-300))
            return allow_continued_sets(copy_with(self.told, log_total=log_total), self.model, ~self.free)
        return None

    def search(self, task: MatchingTask, solve: Solve, budget: int) -> None:
        """Search among the free targets of the task of all bodies, and add what is found."""
        self.search_among(task, self.free, solve, budget)
        named = list(self.found.named) or self.found.every
        self.named = list({one.tobytes(): one for one in [*self.named, *named]}.values())
        mirrored = np.array(self.found.mirrored, np.int64).reshape(-1, self.task.shape[0])
        self.weighed = weigh_labellings(
            self.model, judge_determined(self.model, np.array(self.named)), mirrored, of_several=True
        )


def match_bodies_in_space(task: MatchingTask, solve: Solve) -> Finding:
    """The match of a task of two point sets of one space whose source points are of several bodies.

    ``solve``: from the task of one body to what its search proposes.
    """
    bodies = [_make_body(task, k) for k in range(len(task.each_body))]

    def search(body: _Body, budget: int) -> None:
        body.search(task, solve, budget)
        if all(other.among >= 0 for other in bodies):
            _weigh(bodies)

    with suppress(OutOfTime):
        for body in bodies:
            body.copies = sum(is_same_body(body.model.clouds.source, one.model.clouds.source) for one in bodies)
        _predict(task, bodies)
        with task.deadline.part(SEARCHED).enforce():
            search_rounds(task, bodies, _Body.is_worth_searching, search)
    if task.deadline.passed():
        with suppress(OutOfTime):
            _weigh(bodies)
    return _finding(task, bodies)


def _make_body(task: MatchingTask, number: int) -> _Body:
    """A body for which nothing has been found yet."""
    own = task.each_body[number]
    model = make_point_set_model(own)
    assert model is not None
    nothing = empty_weighed(own.shape[0])
    told = PointSetPosterior(nothing.assignments, nothing.log_mass)
    free = np.ones(task.shape[1], np.bool_)
    return _Body(
        number=number, task=own, found=make_empty_finding(own, None), model=model, weighed=nothing, told=told, free=free
    )


def _predict(task: MatchingTask, bodies: list[_Body]) -> None:
    """Look about the predicted motions; what shows enough of itself there needs no search."""
    with prediction_deadline(task.deadline).within():
        every = [(body, some) for body in bodies if (some := predicted_labellings(body.model))]
        named = [some for _, some in every]
        judged = judge_jointly([body.model for body, _ in every], named) if every else []
        for (body, some), found in zip(every, judged, strict=True):
            # what is searched for anyway is not weighed before: about a vague prediction much is nearly as good
            if is_motion_search_needless(body.model, found):
                checkpoint()
                body.predict(some, found)
    if any(body.predicted is not None for body in bodies):
        _weigh(bodies)
        for body in bodies:
            if body.is_as_predicted:
                body.enough, body.among = True, len(body.free)
        _share(bodies)


def _weigh(bodies: list[_Body]) -> None:
    """Weigh all bodies together."""
    with final_deadline().enforce():
        told = joint_posterior([body.model for body in bodies], [body.weighed for body in bodies])
    for body, one in zip(bodies, told, strict=True):
        body.told = copy_with(one, copies=body.copies)
    _share(bodies)


def _share(bodies: list[_Body]) -> None:
    """Settle the bodies that are sure, and say which targets are left for each."""
    all_known = all(body.among >= 0 for body in bodies)
    used = np.zeros((len(bodies), len(bodies[0].free)))
    for k, body in enumerate(bodies):
        if body.enough or all_known:
            body.settled = body.told.motion >= SURE
            used[k] = body.told.used(used.shape[1])
    for k, body in enumerate(bodies):
        body.free = used.sum(axis=0) - used[k] < SURE


def _finding(task: MatchingTask, bodies: list[_Body]) -> Finding:
    """The finding of all bodies, each without the targets of those more certain."""
    taken = np.zeros(task.shape[1], np.bool_)
    found: dict[int, Finding] = {}
    for body in sorted(bodies, key=lambda one: -one.told.motion):
        beside = body.beside()
        own = body.told if beside is None else beside
        one = point_set_finding(body.found, own, body.model, taken, asked=beside is not None)
        taken |= used_mask(one.assignment[None], len(taken))[0]
        by_law = body.told.present - own.present > LIKELY
        told = BY_ITS_LAW if by_law else None if len(own.assignments) else body.found.reason
        reason = LATE if body.among < 0 else told
        found[body.number] = one if one.reason == reason else copy_with(one, reason=reason)
    return join_findings(task, [found[body.number] for body in bodies], sum(body.evaluated for body in bodies))

"""Several known rigid bodies among points of a space: searched for one by one, and weighed together.

As `rootmatch.explain.image_bodies` does in an image: targets that are certainly of some body are left out of the
searches for others, no body takes targets before all others have been tried on them, and the result is the posterior
over everything that any of the searches proposed.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np

from rootmatch.arrays import Bools, Integers
from rootmatch.deadline import OutOfTime
from rootmatch.explain.bodies import CONFIRMED, LATE, ROUNDS, SURE, Solve, budgets_of, searched_among
from rootmatch.explain.body_findings import joined
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import TRUST
from rootmatch.explain.finding import Finding, empty_tensor, nothing_found, unjudged
from rootmatch.explain.point_set_decision import model_of, told_by, wholly_predicted
from rootmatch.explain.task import MatchingTask
from rootmatch.model.modes import uses_of
from rootmatch.model.point_set_bodies import joint_posterior
from rootmatch.model.point_set_model import PointSetModel
from rootmatch.model.point_set_posterior import PointSetPosterior, Weighed, nothing_weighed, weighed
from rootmatch.samplers.base import SampledTensor


@dataclass(eq=False)
class _Body:
    """One body in the course of the search."""

    number: int
    task: MatchingTask
    """Of its points and all targets."""
    points: Integers
    model: PointSetModel
    found: Finding
    """Of its last search."""
    weighed: Weighed
    told: PointSetPosterior
    free: Bools
    """Targets among which it may still be found."""
    named: list[Integers] = field(default_factory=list)
    """What its searches proposed."""
    enough: bool = False
    """Whether all its points are where it was predicted."""
    settled: bool = False
    budget: int = 0
    """Of the last search for it."""
    cut: bool = False
    """Whether that ended by its budget."""
    among: int = -1
    """Number of free targets at that search; −1 before the first."""
    evaluated: int = 0
    """Evaluations of all its searches."""

    def worth_a_search(self, budget: int) -> bool:
        """Whether another search among the free targets, with this budget, may find more than the last one."""
        if self.settled:
            return False
        fewer = int(self.free.sum()) < self.among
        left = not len(self.told.assignments) or not (self.told.used(len(self.free)) * self.free).any()
        return self.among < 0 or (self.cut and (fewer or budget > self.budget)) or (fewer and left)

    def predict(self) -> None:
        """Add what has a target for each point where the body is predicted, if there is one.

        No other motion could explain more: then nothing is searched.
        """
        named = wholly_predicted(self.model)
        if not named:
            return
        found = weighed(self.model, np.array(named), of_several=True)
        (told,) = joint_posterior([self.model], [found])
        first = told.assignments[:1]
        holds = (first >= 0).all() and told.motion >= SURE and self.model.held(self.model.fit(first))[0] >= 0
        if holds:
            _, base = unjudged(self.task, SampledTensor(empty_tensor(self.task), 0), None)
            self.found, self.weighed = replace(base, scoreless=True), found
            self.named, self.enough, self.among = named, True, len(self.free)

    def search(self, task: MatchingTask, solve: Solve, budget: int) -> None:
        """Search among the free targets of the task of all bodies, and add what is found."""
        self.budget, self.among = budget, int(self.free.sum())
        self.found, self.cut = searched_among(task, self.number, np.flatnonzero(self.free), budget, solve)
        self.evaluated += self.found.evaluated
        named = list(self.found.named) or self.found.every
        self.named = list({one.tobytes(): one for one in [*self.named, *named]}.values())
        mirrored = np.array(self.found.mirrored) if len(self.found.mirrored) else None
        self.weighed = weighed(self.model, np.array(self.named), mirrored, of_several=True)

    def confirm(self, task: MatchingTask, solve: Solve) -> None:
        """Search the targets of a sure body again if its search was cut short before it looked for other motions.

        Other bodies may be elsewhere, but these targets have one owner, so only they are searched.
        """
        if self.found.facts.missed <= TRUST.missed or self.told.motion < SURE:
            return
        first = self.told.assignments[0]
        if np.count_nonzero(first >= 0) < CONFIRMED:
            return
        again, _ = searched_among(task, self.number, np.sort(first[first >= 0]), self.budget, solve)
        self.evaluated += again.evaluated
        if again.facts.missed <= TRUST.missed:
            self.found = self.found.with_facts(missed=again.facts.missed)


def match_bodies_in_space(task: MatchingTask, solve: Solve) -> Finding:
    """The match of a task of two point sets of one space whose source points are of several bodies.

    Parameters
    ----------
    task : MatchingTask
        With labels.
    solve : callable
        From the task of one body to what its search proposes.
    """
    assert task.bodies is not None
    bodies = [_body(task, k) for k in range(len(task.bodies.names))]
    with suppress(OutOfTime):
        for body in bodies:
            body.predict()
        _weigh(bodies)
        _search(task, bodies, solve)
        for body in bodies:
            body.confirm(task, solve)
    if task.deadline.passed():
        _weigh(bodies)
    return _finding(task, bodies)


def _body(task: MatchingTask, number: int) -> _Body:
    """A body for which nothing has been found yet."""
    assert task.bodies is not None
    own = task.body(number)
    model = model_of(own)
    assert model is not None
    nothing = nothing_weighed(own.shape[0])
    told = PointSetPosterior(nothing.assignments, nothing.log_mass)
    free = np.ones(task.shape[1], np.bool_)
    return _Body(number, own, task.bodies.points_of(number), model, nothing_found(own, None), nothing, told, free)


def _search(task: MatchingTask, bodies: list[_Body], solve: Solve) -> None:
    """Search for each body until nothing more can be expected."""
    budgets = budgets_of(task)
    for turn in count():
        budget = budgets[min(turn, ROUNDS - 1)]
        searched = False
        for body in bodies:
            if body.worth_a_search(budget):
                searched = True
                body.search(task, solve, budget)
                if all(other.among >= 0 for other in bodies):
                    _weigh(bodies)
        if (not searched and turn + 1 >= ROUNDS) or task.deadline.passed():
            break


def _weigh(bodies: list[_Body]) -> None:
    """Weigh all bodies together, settle those that are sure, and say which targets are left for each."""
    told = joint_posterior([body.model for body in bodies], [body.weighed for body in bodies])
    known = [body.among >= 0 for body in bodies]
    used = np.zeros((len(bodies), len(bodies[0].free)))
    for k, (body, one) in enumerate(zip(bodies, told, strict=True)):
        body.told = one
        if body.enough or all(known):
            body.settled = one.motion >= SURE
            used[k] = one.used(used.shape[1])
    for k, body in enumerate(bodies):
        body.free = used.sum(axis=0) - used[k] < SURE


def _finding(task: MatchingTask, bodies: list[_Body]) -> Finding:
    """The finding of all bodies, each without the targets of those more certain."""
    assert task.bodies is not None
    taken = np.zeros(task.shape[1], np.bool_)
    found: dict[int, Finding] = {}
    for body in sorted(bodies, key=lambda one: -one.told.motion):
        one = told_by(body.found, body.told, body.model, taken)
        taken |= uses_of(one.assignment[None], len(taken))[0]
        reason = LATE if body.among < 0 else None if len(body.told.assignments) else body.found.reason
        found[body.number] = one if one.reason == reason else replace(one, reason=reason)
    names = task.bodies.names
    every: list[tuple[Label, Integers, Finding]] = [(names[k], body.points, found[k]) for k, body in enumerate(bodies)]
    return joined(task, every, sum(body.evaluated for body in bodies))

"""Several known rigid bodies in one image: searched for one by one, and weighed together.

Detections that are certainly of some body are left out of the searches for others, so bodies that show little are
searched for among few: short searches for all come before longer ones for the rest. No body takes detections before
all others have been tried on them: bodies of a family may differ by one point. The result is the posterior over
everything that any of the searches proposed, including look-alikes of other bodies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.deadline import OutOfTime, checkpoint
from rootmatch.explain.bodies import (
    ROUNDS,
    SURE,
    Choice,
    SearchedBody,
    SearchPart,
    Solve,
    is_mostly_shown,
    search_budgets,
    search_order,
    search_rounds,
    why_unsearched,
)
from rootmatch.explain.body_findings import join_findings
from rootmatch.explain.body_labels import twin_points
from rootmatch.explain.decide import TRUST
from rootmatch.explain.finding import Finding, make_empty_finding
from rootmatch.explain.image_decision import image_finding
from rootmatch.explain.image_hypotheses import (
    LIKELY,
    NAMED,
    Candidate,
    is_search_needless,
    propose_predicted,
    weigh_candidates,
)
from rootmatch.explain.in_time import prediction_deadline
from rootmatch.explain.known_place import find_pairs_by_angle
from rootmatch.explain.known_pose import propose_by_knowledge
from rootmatch.explain.likeness import look_alike_by_errors
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.mode_search import HOPELESS, NEGLIGIBLE, find_modes
from rootmatch.model.pose_density import Doubted
from rootmatch.model.posterior import Posterior, empty_posterior
from rootmatch.model.priors import PRESENT_ODDS
from rootmatch.model.proposals import Proposals, join_proposals

IN_VIEW, DOUBTED = 0.95, 0.9
"""Probabilities that a body is in view, and of its pose: if the first is higher and the second lower, a longer search
would add nothing, because several poses explain as much, unless it missed one that explains more. Round values."""
OF_IMAGE = "areas", "clutter", "image_indices", "images", "rays", "_in_each_image", "_log_counts"
"""What a model works out of the detections alone: the same for all bodies."""
MIN_LEFT = 0.1
"""Share of a frame's budget for a rival of what was found, whatever the search before has left. A round value."""


def _with_remaining_budget(task: MatchingTask, bodies: Sequence[SearchedBody]) -> MatchingTask:
    """The task with what the searches of a frame have left of its budget; among few detections hardly any is needed."""
    if task.budget is None:
        return task
    left = task.budget - sum(body.evaluated for body in bodies)
    return copy_with(task, budget=max(left, round(MIN_LEFT * task.budget)))


@dataclass(eq=False, kw_only=True)
class _Body(SearchedBody):
    """A body of which everything that was proposed is weighed with all others."""

    candidate: Candidate
    told: Posterior
    free: Bools
    """Detections among which it may still be found."""
    used: Floats
    """Probability that each detection is its own; 0 before its rivals have been tried on them."""
    alike: list[int] = field(default_factory=list)
    """Numbers of the bodies of the same or the mirrored shape."""
    rivals: list[int] = field(default_factory=list)
    """Numbers of the bodies that have to be tried on its detections before it takes them."""
    predicted: Proposals | None = None
    enough: bool = False
    """Whether its prediction explains so much that no search is needed."""
    answer: tuple[tuple[Any, ...], Finding] | None = None
    """What was last told of it, after what that follows from."""

    @property
    def pose(self) -> float:
        """Probability of its best pose."""
        return float(self.told.probabilities[0]) if len(self.told.probabilities) else 0.0

    @property
    def is_new(self) -> bool:
        """Whether it is most probably where no prediction expects it, in one place or another."""
        modes, prior, chances = self.told.modes, self.candidate.model.prior, self.told.probabilities
        if isinstance(prior, Doubted):
            chances = chances[prior.prediction_indices(modes.rotation, modes.position) < 0]
        return bool(chances.sum() >= LIKELY)

    @property
    def is_lost(self) -> bool:
        """Whether it is neither predicted nor was searched for."""
        return self.predicted is None and self.among < 0

    @property
    def is_known(self) -> bool:
        """Whether it was searched for, or its prediction makes a search unnecessary."""
        return self.among >= 0 or self.enough

    @property
    def needs_others(self) -> bool:
        """Whether its pose would not be certain if nothing were known of what the other bodies explain.

        A search among all detections ends where it has met what is beyond chance among these, or another body's place.
        """
        masses = self.candidate.modes.log_mass + PRESENT_ODDS
        alone = self.told.modes.log_mass[:1] + PRESENT_ODDS - np.logaddexp.reduce(np.append(masses, 0.0))
        return bool((alone < math.log(SURE)).any())

    def is_worth_searching(self, budget: int) -> bool:
        """Whether another search among the free detections, with this budget, may find more than the last one."""
        if (self.settled and not self.needs_others) or (self.among < 0 and self.enough):
            return False
        fewer = self.among < 0 or int(self.free.sum()) < self.among
        torn = self.told.shown >= IN_VIEW and self.pose < DOUBTED
        if torn and not (self.told.used(len(self.free)) * self.free).any():
            return False  # it has one of the places that bodies of its shape were found in
        met = torn and self.found.facts.missed <= TRUST.missed
        return fewer or (self.cut and budget > self.budget and not met)

    def search(self, task: MatchingTask, solve: Solve, budget: int) -> None:
        """Search among the free detections of the task of all bodies, and add what is found."""
        self.search_among(task, self.free, solve, budget)
        if self.found.posterior is not None:
            self.candidate = self.candidate.add_modes(self.found.posterior.modes)
        elif self.found.named:
            self.candidate = self.candidate.add_assignments(self.found.named[:NAMED])

    def predict(self) -> None:
        """Add what is assigned about the predicted pose, if there is one."""
        if self.task.prior_pose is not None:
            self.predicted = propose_predicted(self.candidate.model, self.task.rivals.narrowed)
        elif self.task.known is not None:
            self.predicted = propose_by_knowledge(
                self.task, self.candidate.model, find_pairs_by_angle(self.task, self.task.known)
            )
        if self.predicted is not None:
            self.candidate = self.candidate.with_assignments([], self.predicted)

    def tell(self, taken: Bools, of_others: Bools) -> Finding:
        """What is told of it, see `image_finding`; worked out anew if it may be something else than the last time."""
        given = self.found, self.told, taken.tobytes(), of_others.tobytes()
        if self.answer is None or self.answer[0] != given:
            found = image_finding(self.found, self.told, self.candidate, taken=taken, of_others=of_others)
            self.answer = given, found
        return self.answer[1]


def match_bodies_in_image(task: MatchingTask, solve: Solve, choice: Choice | None = None) -> Finding:
    """The match of a task of one image whose source points are of several bodies.

    ``solve`` matches one of them; ``choice`` says what to search, everything if not given.
    """
    bodies = [_make_body(task, k) for k in range(len(task.each_body))]
    for body in bodies:
        others = [other for other in bodies if other is not body]
        source = body.task.points.source
        body.alike = [one.number for one in others if twin_points(source, one.task.points.source) is not None]
        # a tracker's earlier frames have tried all of them
        body.rivals = [other.number for other in others] if choice is None else body.alike

    def search(body: _Body, budget: int, task: MatchingTask = task) -> None:
        before, told = body.candidate, list[Posterior]()
        body.search(task, solve, budget)
        new = body.candidate is not before and body.found.posterior is None
        if new and _is_taken(body, bodies):
            # what others explain is weighed against them before its twins are proposed
            told = weigh_candidates([one.candidate for one in bodies])
            new = told[body.number].shown > math.exp(-NEGLIGIBLE)
            if not new and choice is not None:  # the next frames look again
                body.candidate = before
        if new:
            alone, body.candidate = body.candidate, body.candidate.add_twins()
            told = told if body.candidate.modes is alone.modes else []
        if choice is None or body.candidate is not before:
            _weigh(bodies, told)

    with suppress(OutOfTime):
        _predict(task, bodies)
        if choice is None:
            search_rounds(task, bodies, _Body.is_worth_searching, search)
            tried = set[tuple[int, bytes]]()
            for _ in range(ROUNDS):
                if _try_in_places_of_others(bodies, tried):
                    search_rounds(task, bodies, _Body.is_worth_searching, search)
        else:
            predicted = _finding(task, bodies)
            if (part := choice(predicted)) is None:
                return predicted
            body = bodies[part.body]
            body.free = _detections_to_search(part, bodies)
            before, budget, of_part = body.candidate, search_budgets(task)[0], part.of(task)
            search(body, budget, of_part)
            for rival in bodies:
                if body.candidate is not before and body.is_new and rival.is_lost:
                    rival.free = body.told.used(task.shape[1]) > 1.0 - SURE  # in each of its places
                    search(rival, budget, _with_remaining_budget(of_part, bodies))
    return _finding(task, bodies)


def _detections_to_search(part: SearchPart, bodies: Sequence[_Body]) -> Bools:
    """The detections (n',) among which a frame searches for a body.

    Unless it is sought among the rest, with its own: a pose elsewhere may explain them better.
    """
    body = bodies[part.body]
    taken = np.zeros(len(body.free))
    for one in bodies:
        if one is body:
            taken += part.rest * one.told.used(len(taken))
        elif is_mostly_shown(one.told):  # what it holds on to with a few of its points is not its own for certain
            taken += one.told.used(len(taken)) if one.number in part.tried else one.used
    return (body.free | (not part.rest)) & (taken < SURE)


def _try_in_places_of_others(bodies: list[_Body], tried: set[tuple[int, bytes]]) -> bool:
    """Try each body where others may be, as far as its points are known; whether anything was tried.

    Of points with errors a search meets many places that nearly fit, and the right one may not be among those that it
    keeps: then another body takes that, and leaves its own. ``tried``: bodies and places, so far.
    """
    places = [(one, one.told.modes.take(np.flatnonzero(one.told.probabilities > 1.0 - SURE))) for one in bodies]
    new = False
    for body in bodies:
        parts, own = list[Proposals](), body.candidate.model
        for other, modes in places:
            keys = [(body.number, one.tobytes()) for one in modes.assignments]
            some = modes.take(np.array([k for k, key in enumerate(keys) if key not in tried], np.int64))
            tried.update(keys)
            if other is not body and len(some.assignments):
                there = Proposals(some.assignments, some.rotation, some.position)
                parts += look_alike_by_errors(there, (other.task, other.candidate.model), (body.task, own))
        if parts:
            found = find_modes(own, join_proposals(parts), body.candidate.modes, of_several=True, minimum=-HOPELESS)
            body.candidate, new = copy_with(body.candidate, modes=found), True
    if new:
        _weigh(bodies)
    return new


def _finding(task: MatchingTask, bodies: list[_Body]) -> Finding:
    """The finding of all bodies by what is proposed so far, each without the detections of those more certain."""
    taken = np.zeros(task.shape[1], np.bool_)
    found, each = dict[int, Finding](), {one.number: one.told.used(task.shape[1]) for one in bodies}
    used = np.sum([*each.values()], axis=0)
    for body in sorted(bodies, key=lambda one: -one.pose):
        one = body.tell(taken, used - each[body.number] >= SURE)
        taken[one.assignment[one.assignment >= 0]] = True
        unseen = why_unsearched(body.task) if body.among < 0 else one.reason
        reason = None if len(body.told.probabilities) else unseen
        found[body.number] = one if one.reason == reason else copy_with(one, reason=reason)
    return join_findings(task, [found[body.number] for body in bodies], sum(body.evaluated for body in bodies))


def _is_taken(body: _Body, bodies: Sequence[_Body]) -> bool:
    """Whether other bodies certainly have a detection of its first mode."""
    count, own = body.candidate.model.shape[1], body.candidate.modes.assignments[:1]
    used = sum((one.told.used(count) for one in bodies if one is not body), np.zeros(count))
    return bool((used[own[own >= 0]] >= SURE).any())


def _make_body(task: MatchingTask, number: int) -> _Body:
    """A body for which nothing has been found yet."""
    own, count = task.each_body[number], task.shape[1]
    nothing, told = make_empty_finding(own, None), empty_posterior(own.rows)
    free, used = np.ones(count, np.bool_), np.zeros(count)
    return _Body(
        number=number, task=own, found=nothing, candidate=Candidate.of(own, []), told=told, free=free, used=used
    )


def _predict(task: MatchingTask, bodies: list[_Body]) -> None:
    """Look about the predicted poses."""
    known = dict[str, Any]()
    with prediction_deadline(task.deadline).within():
        for body in search_order(task, bodies):
            checkpoint()
            of_body = vars(body.candidate.model)
            of_body.update(known)
            body.predict()
            known = {name: of_body[name] for name in OF_IMAGE if name in of_body}
    with suppress(OutOfTime):
        _weigh(bodies)


def _weigh(bodies: list[_Body], known: Sequence[Posterior] = ()) -> None:
    """Weigh all bodies together, unless that is ``known``, settle the sure ones, and say what is left for each."""
    for body, told in zip(bodies, known or weigh_candidates([body.candidate for body in bodies]), strict=True):
        body.told, body.settled = told, False
        body.enough = body.task.prior_pose is not None and is_search_needless(
            body.candidate.model, told, body.task.minimal, of_several=True
        )
        # a known rotation proposes every pose that agrees with it
        body.enough |= body.task.known is not None and body.predicted is not None and body.pose >= SURE
    for body in bodies:
        if all(bodies[number].is_known for number in (body.number, *body.rivals)):
            body.settled, body.used = body.pose >= SURE, body.told.used(len(body.free))
        else:
            body.used = np.zeros(len(body.free))
    total = np.sum([body.used for body in bodies], axis=0)
    for body in bodies:
        # bodies of one shape share the places that any of them was found in; each needs one more of them
        body.free = (total if body.alike else total - body.used) < SURE

"""Diagnosis of an input that does not match: the usual mistakes, each tried and weighed by its evidence."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rootmatch.deadline import Deadline
from rootmatch.errors import InputError, InputWarning
from rootmatch.explain.decide import TRUST, Status
from rootmatch.explain.explain import explain
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import Misfit
from rootmatch.explain.mistake import Change, Mistake
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.usual_mistakes import NOISIER, usual_mistakes
from rootmatch.samplers.limits import LIMITS

FEWEST_FREEDOM = 6
"""Degrees of freedom of a match that tell a factor on σ, those of four points in space: three stray points look like
noise as easily."""
LEAD = 5.0
"""Log-odds over what was found as given, and over changes that mean nothing, from which a change corrects a mistake:
noise prefers one or another. A value that was fitted costs as much: one known to .3 % of its prior's width. A round
value."""

LONGER = 10
"""How many times as many evaluations a search may take as that of an input that matched as given: what corrects a
mistake explains more than that, and is met sooner. A round value."""


@dataclass(frozen=True)
class Trial:
    """One possible mistake, and the match after correcting it.

    Parameters
    ----------
    mistake : str
        The mistake; empty for the input as given.
    remedy : str
        What to change.
    status : Status
    matched : int
        Number of matches.
    log_odds : float or None
        Log-odds of the match against clutter alone, see `rootmatch.Match.log_odds`; less 5 for each value of the camera
        that was fitted to the points.
    probability : float or None
        Probability that this is the mistake, among all that were tried, the input as given, and the absence of the
        object. All mistakes have the same prior probability, and together that of the input as given.
    borne_out : bool
        False if the noise is said to be larger, and the residuals of the match do not show it; or if a small change of
        the camera fits hardly better than others of its size.
    bodies : (int, int), optional
        Of several bodies, how many are trusted, and how many there are. Points and log-odds are those of the trusted
        ones then, unless there is none.
    """

    mistake: str
    remedy: str
    status: Status
    matched: int
    log_odds: float | None
    probability: float | None = None
    borne_out: bool = True
    bodies: tuple[int, int] | None = None

    @property
    def is_trusted(self) -> bool:
        """Whether the match is trusted, or that of any of several bodies: others may not be there."""
        return self.status is Status.MATCHED if self.bodies is None else self.bodies[0] > 0

    def __str__(self) -> str:
        odds = "" if self.log_odds is None else f", log-odds {self.log_odds:.1f}"
        told, status = self.mistake or "as given", self.status.name.lower()
        if self.bodies is not None:
            status = f"{self.bodies[0]} of {self.bodies[1]} bodies matched"
        return f"{told}: {status}, {self.matched} points{odds}"


@dataclass(frozen=True)
class Diagnosis:
    """The trials, the best explanation first.

    Parameters
    ----------
    given : Trial
        The input as it was given.
    trials : tuple of Trial
        Each mistake that could be tried in time.
    left_out : int
        Number of mistakes for which there was no time.
    """

    given: Trial
    trials: tuple[Trial, ...]
    left_out: int = 0

    @property
    def fits(self) -> tuple[Trial, ...]:
        """Mistakes that would explain the points: their match is trusted and more probable than the input as given.

        By far, if that found anything itself.
        """
        before = -math.inf if self.given.log_odds is None else self.given.log_odds + LEAD
        trusted = [one for one in self.trials if one.is_trusted and one.borne_out]
        return tuple(one for one in trusted if one.log_odds is None or one.log_odds > max(before, 0.0))

    @property
    def nearest(self) -> Trial | None:
        """The most probable mistake if none explains the points, and that one not alone: another may be beside it."""
        before = 0.0 if self.given.log_odds is None else max(self.given.log_odds, 0.0)
        best = next((one for one in self.trials if one.borne_out and one.log_odds is not None), None)
        by_far = best is not None and best.log_odds is not None and best.log_odds > before + LEAD
        return best if by_far and not self.fits else None

    def __str__(self) -> str:
        late = f"; no time for {self.left_out} more" if self.left_out else ""
        if not self.fits:
            near = "" if self.nearest is None else f"; the nearest is {self.nearest}; {self.nearest.remedy}"
            none = f"diagnosis: none of the {len(self.trials)} usual mistakes explains the points by itself"
            return f"{none}{late} ({self.given}){near}"
        lines = [f"diagnosis: {one}; {one.remedy}" for one in self.fits]
        return "\n".join([*lines, f"diagnosis: {self.given}{late}"])


def try_mistakes(match: Any, judge: Callable[[Finding], Any], max_seconds: float) -> Diagnosis:
    """Try the usual mistakes; see `rootmatch.Match.diagnose`.

    ``judge`` makes the match of a finding; passed in because this package is a layer below.
    """
    given = _trial(Mistake("", "", lambda task: task), match)
    every = replace(_task_of_the_rest(match), kept_searches=[], budget=_budget(match))
    mistakes = list(usual_mistakes(every)) if every.shape[1] >= every.problem.order else []
    deadline, trials, skipped = Deadline(max_seconds), list[Trial](), 0
    for k, mistake in enumerate(mistakes):
        if mistake.if_nothing_fits and Diagnosis(given, tuple(trials)).fits:
            skipped += 1
            continue
        seconds = deadline.left() / (len(mistakes) - k)  # time that one leaves is for the others
        if seconds <= 0.0:
            break

        def try_change(change: Change, until: Deadline) -> Any:
            options = replace(match.task.options, max_seconds=max(until.left(), 0.0), progress=None)
            with warnings.catch_warnings():  # of what the user did not give
                warnings.simplefilter("ignore", InputWarning)
                return judge(explain(change(replace(every, options=options, deadline=until))))

        try:
            until = Deadline(seconds)
            trial = _trial(mistake, try_change(mistake.change, until))
            if trial in Diagnosis(given, (trial,)).fits and mistake.rivals:
                others = [_trial(mistake, try_change(change, until)).log_odds or 0.0 for change in mistake.rivals]
                trial = replace(trial, borne_out=(trial.log_odds or 0.0) > max(others) + LEAD)
            trials.append(trial)
        except InputError:  # such as pixels where the changed lens shows nothing
            trials.append(Trial(mistake.name, mistake.remedy, Status.UNTRUSTED, 0, None))
    weighed = _weigh_trials(given, trials)
    # as they are printed: those that differ by less stay in their order, the commonest first
    ranked = sorted(weighed, key=lambda one: math.inf if one.log_odds is None else -round(one.log_odds, 1))
    return Diagnosis(given, tuple(ranked), len(mistakes) - len(trials) - skipped)


def _budget(match: Any) -> int | None:
    """Evaluations of the search of a trial; None, as many as it takes, if not all matches as given."""
    task: MatchingTask = match.task
    if task.budget is not None or match.status is not Status.MATCHED or not match.evaluated:
        return task.budget
    return int(LONGER * max(match.evaluated, LIMITS.quick))


def _task_of_the_rest(match: Any) -> MatchingTask:
    """The task of a match; of one of several bodies between point sets, without targets of others that are matched."""
    task: MatchingTask = match.task
    if match.whole is None or task.problem.point_clouds(task.points) is None:
        return task
    others = [one for one in match.whole.parts.values() if one is not match.finding and one.status is Status.MATCHED]
    free = np.setdiff1d(np.arange(task.shape[1]), np.concatenate([[-1], *(one.assignment for one in others)]))
    return task.subset(None, free)


def _trial(mistake: Mistake, match: Any) -> Trial:
    every = [match] if match.bodies is None else [*match.bodies.values()]
    trusted = [one for one in every if one.status is Status.MATCHED]
    matched = sum(int((one.assignment >= 0).sum()) for one in trusted or every)
    # for an untrusted match, they may take longer to compute than the match did
    odds = [one.finding.log_odds if one.status is Status.UNTRUSTED else one.log_odds for one in trusted or every]
    known = None if None in odds else float(sum(odds))
    bodies = None if match.bodies is None else (len(trusted), len(every))
    borne_out = _is_borne_out(NOISIER[mistake.name], match.finding) if mistake.name in NOISIER else True
    if mistake.complete and trusted:
        mistake = mistake.complete(mistake, match)
    known = known - LEAD * mistake.fitted if matched and known is not None else None
    return Trial(mistake.name, mistake.remedy, match.status, matched, known, borne_out=borne_out, bodies=bodies)


def _is_borne_out(factor: float, found: Finding) -> bool:
    """Whether the residuals of a match with a larger σ would be rare with the σ that was given.

    With few matches, or points on a line, a larger σ may let a match be found that the given one fits as well.
    """
    if found.noise_factor is None:
        return True  # nothing tells
    if found.noise_dof < FEWEST_FREEDOM:
        return False
    sigma = factor * found.noise_factor
    return Misfit(sigma**2, sigma, found.noise_dof).chance < TRUST.noise_chance


def _weigh_trials(given: Trial, trials: list[Trial]) -> list[Trial]:
    """The trials with their probabilities."""
    every = [given, *trials]
    if not trials:
        return []
    prior = [math.log(0.5)] + [math.log(0.5 / len(trials))] * len(trials)
    odds = [-math.inf if one.log_odds is None else one.log_odds + p for one, p in zip(every, prior, strict=True)]
    terms = np.array([0.0, *odds])  # nothing is to be found
    terms = np.exp(terms - terms.max())
    shares = (terms / terms.sum())[2:].tolist()
    return [replace(one, probability=share) for one, share in zip(trials, shares, strict=True)]

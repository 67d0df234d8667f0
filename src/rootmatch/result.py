"""`Match`: what matching found, and how far to trust it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.explain.assessment import (
    confidence_against_chance,
    confidence_in,
    confidence_of_motions,
    weighed,
)
from rootmatch.explain.assignment_posterior import Ranked
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import TRUST, Status, advice
from rootmatch.explain.finding import Finding
from rootmatch.explain.poses import Pose, poses_of
from rootmatch.explain.predicted_assignment import fused_pose
from rootmatch.explain.rig_copies import RigCopies
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.validation import check_assignment
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.base import Problem

__all__ = ["Match", "Status", "report"]

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sightings:
    """What each camera of a rig sees.

    Attributes
    ----------
    assignment : (C, n) int64
        Index into the target of each source point in each camera; −1 where it is not seen.
    alternatives : list of (C, n) int64
        The next probable ones.
    poses : list of Pose or None
        Of the rig, one for each body, by all sightings; their ``points`` are camera · n + point.
    confidence : (n,) float64
        Of each point: of its surest sighting, or the least of those that an unseen point lacks.
    """

    copies: Match

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        problem = self.copies.task.problem
        assert isinstance(problem, RigCopies)
        return len(problem.copies.offsets)

    @property
    def assignment(self) -> Integers:
        """Index into the target of each source point in each camera, (C, n); −1 where it is not seen."""
        return self.copies.assignment.reshape(self.cameras, -1)

    @property
    def alternatives(self) -> list[Integers]:
        """The next probable ones."""
        return [other.reshape(self.cameras, -1) for other, _ in self.copies.alternatives]

    @property
    def poses(self) -> list[Pose | None]:
        """Of the rig, one for each body, by all sightings; their ``points`` are camera · n + point."""
        return self.copies.poses

    @property
    def pose(self) -> Pose | None:
        """The first of them."""
        return self.poses[0] if self.poses else None

    @cached_property
    def confidence(self) -> Floats:
        """Of each point (n,): of its surest sighting, or the least of those that an unseen point lacks."""
        each = self.copies.confidence.reshape(self.assignment.shape)
        surest = np.where(self.assignment >= 0, each, -1.0).max(axis=0)
        return np.asarray(np.where((self.assignment >= 0).any(axis=0), surest, each.min(axis=0)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Match:
    """The result of matching: an assignment, how far to trust it, and what it was found from.

    A match is true in a condition only if it can be believed: ``if match:``.

    Attributes
    ----------
    task : MatchingTask
        The validated input: problem, points with their noise, options.
    assignment : (n,) int64
        Index into the target points; −1 where unmatched.
    pairs : (k, 2) int64
        The same as pairs of a source and a target index.
    status : Status
        Whether to trust the assignment, by one rule (`rootmatch.explain.decide.decide`); see `advice`.
    probability : float or None
        Posterior probability that the assignment is right, given that one of those considered is; each is fitted by
        its best pose. None where the problem cannot fit poses, for the paper's residuals and with several motions.
        Computed on first access where the status did not need it.
    log_odds : float or None
        Logarithm of the odds of the assignment and its pose against clutter alone; None where ``probability`` is.
    score : float or None
        Total weight of the hyper-edges inside the assignment; of several bodies the sum, of several motions the
        evidence of the packing. None where a predicted pose decided and no hyper-edge was evaluated.
    margin : float
        Lead in score over the best different assignment: 1 − second / best, 0 for a tie (or where another one scores
        more, but is less probable), 1 where no other scores. With several motions it is the lead over the best packing
        without one of its groups; where a predicted pose decided, the lead in the odds against clutter.
    alternatives : list of ((n,) int64, float or None)
        The best different assignments and their scores, the most probable first where probabilities are known.
    soft_assignment : (n, n') float64
        That of the solver.
    tensor : AffinityTensor
        The affinities that were solved.
    motion_labels : (n,) int64
        Label of the rigid motion, −1 where unmatched.
    converged : bool
        Whether the solver stopped by its own criterion rather than at a limit.
    evaluated : int
        Number of hyper-edges evaluated.
    seconds : float
        Wall-clock time.
    stopped_early : bool
        Whether ``max_seconds`` ended it before it was done.
    noise_factor : float or None
        How many times larger than ``noise`` the noise looks, by the residuals about the best pose: near 1 where σ is
        right. None where no pose was fitted.
    bodies : dict or None
        With ``bodies=`` the match of each body by its label: its own points against all detections. Of the whole,
        margin and status are those of the least trusted body, probability is the product, and ``motion_labels`` numbers
        the bodies in the order in which their labels appear.
    prior_holds : bool or None
        With ``prior=`` whether it held: False where another pose was found without it; None where neither is trusted,
        or without a prior.
    fused_pose : Pose or None
        Pose of the matches and the prior together, where that held.
    sightings : Sightings or None
        With a `rootmatch.Rig` what each camera sees; ``assignment`` then holds the sighting of the first camera that
        has one, and ``poses`` the pose of the rig by all of them.
    """

    finding: Finding
    seconds: float
    stopped_early: bool = False
    sightings: Sightings | None = None
    bodies: dict[Label, Match] | None = None

    def __bool__(self) -> bool:
        return self.status is Status.MATCHED

    @property
    def task(self) -> MatchingTask:
        """The validated input."""
        return self.finding.task

    @property
    def assignment(self) -> Integers:
        """Index (n,) into the target points; −1 where unmatched."""
        return self.finding.assignment

    @property
    def pairs(self) -> Integers:
        """Source and target index of each matched point, (k, 2)."""
        matched = np.flatnonzero(self.assignment >= 0)
        return np.column_stack([matched, self.assignment[matched]])

    @property
    def status(self) -> Status:
        """Whether to trust the assignment."""
        return self.finding.status

    @cached_property
    def score(self) -> float | None:
        """Total weight of the hyper-edges inside the assignment; see `Match`."""
        return _score(self.finding.every_score[0])

    @property
    def margin(self) -> float:
        """Lead over the best different assignment; see `Match`."""
        return self.finding.margin

    @cached_property
    def alternatives(self) -> list[tuple[Integers, float | None]]:
        """The best different assignments and their scores; see `Match`."""
        return [(other, _score(score)) for other, score in self.finding.alternatives]

    @property
    def soft_assignment(self) -> Floats:
        """Soft assignment (n, n') of the solver."""
        return self.finding.soft_assignment

    @property
    def tensor(self) -> AffinityTensor:
        """The affinities that were solved."""
        return self.finding.tensor

    @property
    def motion_labels(self) -> Integers:
        """Label (n,) of the rigid motion of each point, −1 where unmatched."""
        return self.finding.motion_labels

    @property
    def converged(self) -> bool:
        """Whether the solver stopped by its own criterion rather than at a limit."""
        return self.finding.converged

    @property
    def evaluated(self) -> int:
        """Number of hyper-edges evaluated."""
        return self.finding.evaluated

    @property
    def noise_factor(self) -> float | None:
        """How many times larger than ``noise`` the noise looks; see `Match`."""
        return self.finding.noise_factor

    @property
    def prior_holds(self) -> bool | None:
        """Whether the prior held; see `Match`."""
        return self.finding.prior_holds

    @property
    def fused_pose(self) -> Pose | None:
        """Pose of the matches and the prior together, where that held."""
        return self.finding.fused_pose

    @cached_property
    def probability(self) -> float | None:
        """Posterior probability that the assignment is right; see `Match`."""
        if self.finding.probability is not None:
            return self.finding.probability
        if self.sightings is not None:
            return self.sightings.copies.probability
        if self.bodies is not None:
            known = [body.probability for body in self.bodies.values()]
            return None if None in known else float(np.prod(np.array(known, np.float64)))
        found = self._weighed
        return None if found is None else found.probability_of_assignment(self.assignment)

    @cached_property
    def confidence(self) -> NDArray[np.float64]:
        """Posterior probability (n,) that each point's match, or its being unmatched, is right.

        Summed over the assignments that were weighed and their local changes (a point left out, moved to another
        detection or exchanged with another point). Where the status is MATCHED the pose is sure, and the matches that
        are not are left out, so that at most a hundredth of those of a large assignment, or a tenth of one match, is
        expected to be wrong; the assignment with them is then the first alternative. NaN where the problem fits no
        poses, and for the paper's residuals. Computed on first access where the status did not need it.
        """
        if self.sightings is not None:
            return self.sightings.confidence
        if self.finding.confidence is not None:
            return self.finding.confidence
        if self.bodies is not None:
            confidence = np.full(len(self.assignment), np.nan)
            for k, body in enumerate(self.bodies.values()):
                confidence[self.task.bodies.points_of(k)] = body.confidence  # type: ignore[union-attr]
            return confidence
        if self.task.options.packs_motions:
            return confidence_of_motions(self.task, self.assignment, self.motion_labels)
        if self.status is Status.UNTRUSTED and self._weighed is not None:
            return confidence_against_chance(self._weighed, self.assignment)
        return confidence_in(self._weighed, self.assignment)

    @cached_property
    def _weighed(self) -> Ranked | None:
        """What probability and confidence are read from where the status needed neither: found once for both."""
        return weighed(self.task, self.finding.every)

    @cached_property
    def log_odds(self) -> float | None:
        """Logarithm of the odds of the assignment and its pose against clutter alone; see `Match`."""
        if self.finding.log_odds is not None:
            return self.finding.log_odds
        if self.sightings is not None:
            return self.sightings.copies.log_odds
        if self.bodies is not None:
            known = [body.log_odds for body in self.bodies.values()]
            return None if None in known else float(np.sum(np.array(known, np.float64)))
        found = self._weighed
        return None if found is None else found.beyond_chance

    @property
    def source(self) -> NDArray[np.float64]:
        """The source points, (n, 3) or (n, 2)."""
        return self.task.points.source

    @property
    def target(self) -> NDArray[np.float64]:
        """The target points, (n', 2) or (n', 3)."""
        return self.task.points.target

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.task.problem

    @property
    def noise(self) -> Any:
        """σ as given (a number, an array or a pair), or as estimated."""
        return self.task.noise

    @property
    def advice(self) -> str:
        """The status as a sentence, with what can be done about it for this problem."""
        if self.finding.reason is not None:
            return f"no trustworthy match: {self.finding.reason}"
        problem, factor = self.problem, self.noise_factor
        text = advice(self.status, problem)
        blamed = factor is not None and TRUST.noise_factor <= factor <= TRUST.most_named
        if blamed and self.status is Status.UNTRUSTED:
            assert factor is not None
            told = f"noise={factor * self.noise:.2g}" if isinstance(self.noise, int | float) else "a larger noise="
            text = (
                f"no trustworthy match: by its residuals the noise is {factor:.1f} times as large as given; "
                f'give {told}, or noise="auto", and check {problem.to_check}'
            )
        if self.status is Status.MATCHED and self.finding.confidence is not None:
            unsure = int((self.confidence < TRUST.probability).sum())
            text += (
                f"; whether {unsure} of the points have an image, or which, is not sure: see `confidence`"
                if unsure
                else ""
            )
        if self.prior_holds is False:
            text += "; the prior pose was wrong, this one was found without it"
        return f"{text}; max_seconds ended it before it was done" if self.stopped_early else text

    @cached_property
    def poses(self) -> list[Pose | None]:
        """The most likely pose of each motion, with its covariance; see `Pose` for frames and units.

        Fitted to all matches of the motion by maximum likelihood in the noise that was given, or estimated. None for a
        motion with fewer matches than a pose needs (`Problem.least_for_pose`), and where no pose puts them before the
        camera. The covariance is that of the noise, given that the assignment is right; a prior that holds is part
        of the fit.

        Raises
        ------
        InputError
            If the problem fits no poses: derived ones, whose equations do not say what a pose is.
        """
        if self.sightings is not None:
            return self.sightings.poses
        if self.prior_holds and self.task.prior_pose is not None:
            return [fused_pose(self.task, self.assignment)]
        return self.poses_of(self.assignment)

    @cached_property
    def alternative_poses(self) -> list[list[Pose | None]]:
        """The same of each of `alternatives`. With several motions, points keep the motion that they have here."""
        return poses_of(self.task, [other for other, _ in self.alternatives], self.motion_labels)

    def poses_of(self, assignment: ArrayLike) -> list[Pose | None]:
        """The same of any assignment (n,) between these points, −1 where unmatched.

        Raises
        ------
        InputError
            If it is none, and as `poses`.
        """
        return poses_of(self.task, [check_assignment(assignment, self.task.shape)], self.motion_labels)[0]

    @property
    def pose(self) -> Pose | None:
        """The pose of the only body; None if there is none. With several bodies or motions see `bodies` and `poses`.

        Raises
        ------
        InputError
            As `poses`.
        """
        poses = self.poses
        return poses[0] if len(poses) == 1 else None

    def report(self, path: str | Path, **options: Any) -> None:
        """Write the match as one self-contained page for the browser, which needs no network.

        It shows the points and the camera in 3D, the image with reprojections and residuals to scale, the alternatives,
        residuals against χ², support, poses, settings and versions. It needs the extra ``report``.

        Parameters
        ----------
        path : path
            Of the file, ``.html``.
        source_names, target_names : sequences of str, optional
            Of the points; by default their indices.
        truth : (n,) array, optional
            The true assignment: wrong matches are marked.
        photo : path, optional
            A PNG or JPEG that was detected in, drawn behind the target points.
        title : str, optional

        Raises
        ------
        InputError
            If the file or the photograph cannot be used.
        RootmatchError
            If the extra is not installed.
        """
        if self.sightings is not None:
            raise InputError(
                "report: a rig has several images, which a page does not show; see `sightings` and `poses`"
            )
        from rootmatch.report.html import write_report  # plotly and jinja2 are needed here alone

        write_report(self, path, **options)


def _score(value: float) -> float | None:
    """A score, or None where no hyper-edge was evaluated."""
    return None if np.isnan(value) else float(value)


def report(finding: Finding, *, seconds: float, stopped_early: bool = False) -> Match:
    """The public result of what was found: the only place that makes a `Match`.

    Parameters
    ----------
    finding : Finding
    seconds : float
        Wall-clock time that it took.
    stopped_early : bool
    """

    def one(part: Finding, task: MatchingTask | None = None) -> Match:
        copies = isinstance(part.task.problem, RigCopies)
        shown = of_points(part, task) if copies else part
        bodies = None
        if part.parts is not None:
            own: Callable[[int], MatchingTask | None] = shown.task.body if copies else lambda _: None
            bodies = {label: one(body, own(k)) for k, (label, body) in enumerate(part.parts.items())}
        sightings = None
        if copies:
            every = None if bodies is None else {k: _copies(body) for k, body in bodies.items()}
            sightings = Sightings(Match(finding=part, seconds=seconds, stopped_early=stopped_early, bodies=every))
        return Match(finding=shown, seconds=seconds, stopped_early=stopped_early, sightings=sightings, bodies=bodies)

    return one(finding)


def _copies(match: Match) -> Match:
    """The match of the copies of a rig's points."""
    assert match.sightings is not None
    return match.sightings.copies


def of_points(finding: Finding, task: MatchingTask | None = None) -> Finding:
    """The finding of a rig's points by that of their copies: one detection for each point.

    Parameters
    ----------
    finding : Finding
        Of a task of copies.
    task : MatchingTask, optional
        That of the points and the rig, if it is another one than the copies were made of.
    """
    problem = finding.task.problem
    assert isinstance(problem, RigCopies)
    task = task or problem.task
    n, n_target = task.shape
    first, camera = _first_of(finding.assignment.reshape(-1, n))
    others, scores = [], [finding.every_score[0]]
    for other, score in finding.alternatives:
        seen = _first_of(other.reshape(-1, n))[0]
        if not np.array_equal(seen, first):
            others.append(seen)
            scores.append(score)
    points = np.flatnonzero(first >= 0)
    copies = camera[points] * n + points
    soft, labels = np.zeros((n, n_target)), np.full(n, -1, np.int64)
    soft[points, first[points]] = finding.soft_assignment[copies, first[points]]
    labels[points] = finding.motion_labels[copies]
    i, j = np.divmod(finding.tensor.indices.astype(np.int64), max(n_target, 1))
    indices = (i % n * n_target + j).astype(np.int32)
    return replace(
        finding,
        task=task,
        assignment=first,
        others=others,
        scores=scores,
        soft=soft,
        tensor=AffinityTensor.unchecked(indices, np.asarray(finding.tensor.weights), (n, n_target), task.weights),
        labels=labels,
    )


def _first_of(sightings: Integers) -> tuple[Integers, Integers]:
    """The detection of each point in the first camera that has one, −1 for none, and that camera; of (C, n)."""
    seen = sightings >= 0
    camera = seen.argmax(axis=0)
    return np.where(seen.any(axis=0), sightings[camera, np.arange(sightings.shape[1])], -1), camera

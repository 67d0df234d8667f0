"""`Match`: what matching found, and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.errors import InputError
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.on_demand import OnDemand, all_read
from rootmatch.pipeline.assessment import (
    confidence_against_chance,
    confidence_in,
    confidence_of_motions,
    weighed,
)
from rootmatch.pipeline.body_labels import Label
from rootmatch.pipeline.poses import Pose, poses_of
from rootmatch.pipeline.posterior import Ranked
from rootmatch.pipeline.prior import fused_pose
from rootmatch.pipeline.status import TRUST, Status
from rootmatch.pipeline.task import MatchingTask
from rootmatch.pipeline.validation import check_assignment
from rootmatch.problems.base import Problem

__all__ = ["Match", "Status"]


@dataclass(frozen=True, eq=False)
class Sightings:
    """What each camera of a rig sees.

    Attributes
    ----------
    assignment : (C, n) int64
        Index into the target of each source point in each camera; −1 where it is not seen.
    alternatives : list of (C, n) int64
        The next probable ones.
    copies : Match
        Of the copies of the points, one for each camera, in the order camera · n + point.
    """

    assignment: NDArray[np.int64]
    alternatives: list[NDArray[np.int64]]
    copies: Match

    @property
    def poses(self) -> list[Pose | None]:
        """Of the rig, one for each body, by all sightings; their ``points`` are camera · n + point."""
        return self.copies.poses

    @property
    def pose(self) -> Pose | None:
        """The first of them."""
        return self.poses[0] if self.poses else None

    @cached_property
    def confidence(self) -> NDArray[np.float64]:
        """Of each point (n,): of its surest sighting, or the least of those that an unseen point lacks."""
        each = self.copies.confidence.reshape(self.assignment.shape)
        surest = np.where(self.assignment >= 0, each, -1.0).max(axis=0)
        return np.asarray(np.where((self.assignment >= 0).any(axis=0), surest, each.min(axis=0)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Match:
    """The result of matching: an assignment, how far to trust it, and what it was found from.

    Attributes
    ----------
    task : MatchingTask
        The validated input: problem, points with their noise, options.
    assignment : (n,) int64
        Index into the target points; −1 where unmatched.
    score : float
        Total weight of the hyper-edges inside the assignment.
    margin : float
        Lead in score over the best different assignment: 1 − second / best, 0 for a tie (or where another one scores
        more, but is less probable), 1 where no other scores. With several motions the score is the evidence of the
        packing, and the lead that over the best packing without one of its groups.
    probability : float or None
        Posterior probability that the assignment is right, given that one of those considered is; each is fitted by
        its best pose. None where the problem cannot fit poses, for the paper's residuals and with several motions.
        Computed on first access where the status did not need it.
    alternatives : list of ((n,) int64, float)
        The best different assignments and their scores, the most probable first where probabilities are known.
    soft : (n, n') float64
        Soft assignment of the solver.
    tensor : AffinityTensor
        The affinities that were solved.
    motions : (n,) int64
        Label of the rigid motion, −1 where unmatched.
    status : Status
        Whether to trust the assignment, by one rule (`rootmatch.pipeline.status.judged`); see `advice`.
    converged : bool
        Whether the solver stopped by its own criterion rather than at a limit.
    hyperedges : int
        Number of hyper-edges evaluated.
    seconds : float
        Wall-clock time.
    limited : bool
        Whether ``max_seconds`` ended it before it was done.
    fitted_probability : float or None
        The probability, where the status needed it.
    fitted_confidence : (n,) float64 or None
        The confidence, where the status needed it; see `confidence`.
    noise_factor : float or None
        How many times larger than ``noise`` the noise looks, by the residuals about the best pose: near 1 where σ is
        right. None where no pose was fitted.
    fault : str or None
        Why the detections of a frame could not be matched at all; see `rootmatch.Matcher.match`.
    bodies : dict or None
        With ``bodies=`` the match of each body by its label: its own points against all detections. Of the whole, score
        is their sum, margin and status are those of the least trusted body, probability is the product, and ``motions``
        numbers the bodies in the order in which their labels appear.
    prior_holds : bool or None
        With ``prior=`` whether it held: False where another pose was found without it; None where neither is trusted,
        or without a prior. Where it decides alone nothing is sampled: ``score`` is then the logarithm of the odds
        against clutter, ``margin`` the lead in those odds, and the tensor is empty.
    fused_pose : Pose or None
        Pose of the matches and the prior together, where that held.
    sightings : Sightings or None
        With a `rootmatch.Rig` what each camera sees; ``assignment`` then holds the sighting of the first camera that
        has one, and ``poses`` the pose of the rig by all of them.
    """

    task: MatchingTask
    assignment: NDArray[np.int64]
    score: OnDemand[float] = OnDemand()  # noqa: RUF009
    margin: OnDemand[float] = OnDemand()  # noqa: RUF009
    alternatives: OnDemand[list[tuple[NDArray[np.int64], float]]] = OnDemand()  # noqa: RUF009
    soft: OnDemand[NDArray[np.float64]] = OnDemand()  # noqa: RUF009
    tensor: AffinityTensor
    motions: NDArray[np.int64]
    status: Status
    converged: bool
    hyperedges: int
    seconds: float
    limited: bool = False
    fitted_probability: float | None = None
    fitted_confidence: NDArray[np.float64] | None = None
    noise_factor: float | None = None
    fault: str | None = None
    bodies: dict[Label, Match] | None = None
    prior_holds: bool | None = None
    fused_pose: Pose | None = None
    sightings: Sightings | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: values, not the functions that make them."""
        return all_read(self)

    @cached_property
    def probability(self) -> float | None:
        """Posterior probability that the assignment is right; see `Match`."""
        if self.fitted_probability is not None:
            return self.fitted_probability
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
        if self.fitted_confidence is not None:
            return self.fitted_confidence
        if self.sightings is not None:
            return self.sightings.confidence
        if self.bodies is not None:
            confidence = np.full(len(self.assignment), np.nan)
            for k, body in enumerate(self.bodies.values()):
                confidence[self.task.bodies.points_of(k)] = body.confidence  # type: ignore[union-attr]
            return confidence
        if self.task.options.packs_motions:
            return confidence_of_motions(self.task, self.assignment, self.motions)
        if self.status is Status.UNTRUSTED and self._weighed is not None:
            return confidence_against_chance(self._weighed, self.assignment)
        return confidence_in(self._weighed, self.assignment)

    @cached_property
    def _weighed(self) -> Ranked | None:
        """What probability and confidence are read from where the status needed neither: found once for both."""
        return weighed(self.task, self.assignment, self.alternatives)

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
        if self.fault is not None:
            return f"no trustworthy match: {self.fault}"
        advice = self.status.advice(self.problem)
        factor = self.noise_factor
        blamed = factor is not None and TRUST.noise_factor <= factor <= TRUST.most_named
        if blamed and self.status is Status.UNTRUSTED:
            assert factor is not None
            told = f"noise={factor * self.noise:.2g}" if isinstance(self.noise, int | float) else "a larger noise="
            advice = (
                f"no trustworthy match: by its residuals the noise is {factor:.1f} times as large as given; "
                f'give {told}, or noise="auto", and check {self.problem.to_check}'
            )
        if self.status is Status.MATCHED and self.fitted_confidence is not None:
            unsure = int((self.fitted_confidence < TRUST.probability).sum())
            advice += (
                f"; whether {unsure} of the points have an image, or which, is not sure: see `confidence`"
                if unsure
                else ""
            )
        if self.prior_holds is False:
            advice += "; the prior pose was wrong, this one was found without it"
        return f"{advice}; max_seconds ended it before it was done" if self.limited else advice

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
        if self.prior_holds and self.task.predicted is not None:
            return [fused_pose(self.task, self.assignment)]
        return self.poses_of(self.assignment)

    @cached_property
    def alternative_poses(self) -> list[list[Pose | None]]:
        """The same of each of `alternatives`. With several motions, points keep the motion that they have here."""
        return poses_of(self.task, [other for other, _ in self.alternatives], self.motions)

    def poses_of(self, assignment: ArrayLike) -> list[Pose | None]:
        """The same of any assignment (n,) between these points, −1 where unmatched.

        Raises
        ------
        InputError
            If it is none, and as `poses`.
        """
        return poses_of(self.task, [check_assignment(assignment, self.task.shape)], self.motions)[0]

    def pose(self) -> list[Pose | None]:
        """The same as `poses`, under the name that it had first."""
        return self.poses if self.sightings is not None else self.poses_of(self.assignment)

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

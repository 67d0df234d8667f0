"""`Match`: what matching found, and how far to trust it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Floats, Integers
from rootmatch.errors import InputError
from rootmatch.explain.body_labels import Label
from rootmatch.explain.decide import Status
from rootmatch.explain.diagnosis import Diagnosis, try_mistakes
from rootmatch.explain.displaced_points import point_advice
from rootmatch.explain.finding import Finding
from rootmatch.explain.image_decision import other_poses
from rootmatch.explain.inexact_points import noise_factor
from rootmatch.explain.judged_motions import motion_confidence
from rootmatch.explain.predicted_poses import (
    agrees_with_prior,
    assignment_labels,
    finding_poses,
    fit_match_poses,
    fused_pose,
)
from rootmatch.explain.status_advice import advice, is_undetermined
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.assignment import check_assignment
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.base import Problem
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.similarity import Similarity
from rootmatch.sightings import Sightings, reduce_to_first_cameras

__all__ = ["Match", "Status", "report"]


ADVISED = 1.0
"""Seconds at most for mistakes that an advice may name; those of point sets take 0.03 to 0.5. A round value."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Match:
    """The result of matching: an assignment, how far to trust it, and what it was found from.

    A match is true in a condition (``if match:``) only if it can be trusted. Poses, alternatives and whatever else is
    seldom needed are computed when they are first read; `finding` and `shown` are internal.

    Attributes
    ----------
    finding : Finding
        What the last stage of the pipeline found, with a `rootmatch.Rig` in terms of sightings.
    seconds : float
        Wall-clock time.
    stopped_early : bool
        Whether ``max_seconds`` ended the match before it was finished.
    bodies : dict or None
        With ``bodies=``, the match of each body by its label: its own points against all detections. Margin and status
        of the whole match are those of the least trusted body, its probability is the product, and ``motion_labels``
        numbers the bodies in the order in which their labels appear. ``whole`` of each is the finding of all.
    """

    finding: Finding
    seconds: float
    stopped_early: bool = False
    bodies: dict[Label, Match] | None = None
    whole: Finding | None = None

    def __bool__(self) -> bool:
        return self.status is Status.MATCHED

    def __repr__(self) -> str:
        parts = [self.status.name, f"{len(self.pairs)} of {len(self.assignment)} points"]
        if self.probability is not None:
            parts.append(f"probability {self.probability:.3g}")
        parts += [f"{label}: {body}" for label, body in (self.bodies or {}).items()]
        return f"Match({', '.join(parts)})"

    @cached_property
    def sightings(self) -> Sightings | None:
        """With a `rootmatch.Rig`, what each camera sees; None for one camera.

        ``assignment`` then holds, for each point, the detection of the first camera that sees it, and ``poses`` the
        pose of the rig, fitted to all cameras.
        """
        return None if self.task.rig is None else Sightings(self.finding)

    @cached_property
    def shown(self) -> Finding:
        """The finding with one detection of each point."""
        return self.finding if self.sightings is None else reduce_to_first_cameras(self.finding)

    @property
    def task(self) -> MatchingTask:
        """The validated input: problem, points with their noise, options."""
        return self.finding.task

    @property
    def assignment(self) -> Integers:
        """Index (n,) into the target points; −1 where unmatched."""
        return self.shown.assignment

    @property
    def pairs(self) -> Integers:
        """Source and target index of each matched point, (k, 2)."""
        matched = np.flatnonzero(self.assignment >= 0)
        return np.column_stack([matched, self.assignment[matched]])

    @property
    def status(self) -> Status:
        """Whether to trust the assignment, by one rule (`rootmatch.explain.decide.decide`); see `advice`."""
        return self.finding.status

    @cached_property
    def score(self) -> float | None:
        """Total weight of the hyper-edges inside the assignment.

        For several bodies it is the sum, for several motions the evidence of the packing. None if no hyper-edge
        was evaluated: a predicted pose decided, or none of them is possible.
        """
        return None if math.isnan(self.shown.score) else float(self.shown.score)

    @property
    def margin(self) -> float:
        """Lead in score over the best different assignment: 1 − second / best.

        It is 0 for a tie, and if another one scores more, which is less probable or, as the paper's method does not
        maximise the score, was passed over; 1 if no other scores. With several motions it is the lead over the best
        packing without one of its groups; if a predicted pose decided, 1 less the odds against its assignment.
        """
        return self.shown.margin

    @cached_property
    def alternatives(self) -> list[tuple[Integers, float | None]]:
        """The best different assignments and their scores, the most probable first if probabilities are known."""
        return [(other, None if math.isnan(score) else float(score)) for other, score in self.shown.alternatives]

    @property
    def soft_assignment(self) -> Floats:
        """Soft assignment (n, n') of the solver."""
        return self.shown.soft_assignment

    @property
    def tensor(self) -> AffinityTensor:
        """The affinities that were solved."""
        return self.shown.tensor

    @property
    def motion_labels(self) -> Integers:
        """Label (n,) of the rigid motion of each point, −1 where unmatched."""
        return self.shown.motion_labels

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
        """Ratio of the noise that the residuals suggest to the stated noise; None without a pose or residuals."""
        return noise_factor(self.finding)

    @property
    def point_error(self) -> float:
        """Standard deviation of source coordinates with which a body fits although none was stated; 0.0 if not needed.

        Covariances of poses allow for it; `noise_factor`, and ``chi2`` and ``rms_sigma`` of poses, do not.
        """
        return self.finding.point_error

    @property
    def prior_holds(self) -> bool | None:
        """Whether the trusted pose agrees with ``prior=``.

        False if that of any body is too far off, or contradicts the vertical of `UP2P`; None without prior or pose.
        """
        return agrees_with_prior(self.finding)

    @property
    def fused_pose(self) -> Pose | None:
        """Pose of the matches and the prior together; None if there is no prior or it did not hold."""
        return fused_pose(self.finding)

    @cached_property
    def probability(self) -> float | None:
        """Posterior probability that the whole assignment is right.

        If the status is MATCHED and doubtful matches were left out, it is that of those that remain; of so many that a
        thousandth of them is more than 1 − ``min_probability``, that all but this thousandth are right. 0.0 if nothing
        is matched. It comes from a model of all observations, in which the object may be absent, or two views may have
        nothing in common (docs/model.md). With several motions it is the product of theirs, each weighed with the
        points and detections that the others leave, and in two views that of all of them together. None if the problem
        fits no poses, and for the paper's residuals.
        """
        return self._combined("probability", np.prod)

    @cached_property
    def confidence(self) -> Floats:
        """Posterior probability (n,) that each point's match is right or, if it is unmatched, that it has none.

        Summed over the poses that were weighed and their local changes (a point left out, moved to another detection or
        exchanged with another point). If the status is MATCHED, the pose is certain and doubtful matches are left out,
        so many that the rest is right with ``min_probability`` (up to a thousandth of the matches of a large
        assignment). NaN where there was nothing to weigh, and where `probability` is None.
        """
        known = self.finding.all_confidence if self.sightings is None else self.sightings.confidence
        if known is not None:
            return known
        if self.task.options.packs_motions:
            return motion_confidence(self.task, self.assignment, self.motion_labels)
        return np.full(len(self.assignment), np.nan)

    @cached_property
    def log_odds(self) -> float | None:
        """Log-odds of the match against clutter alone, 0.0 if nothing is matched; None if `probability` is."""
        return self._combined("log_odds", np.sum)

    def _combined(self, name: str, of_bodies: Callable[[list[float]], Any]) -> float | None:
        """A number of the finding, or of all bodies together; None if there is none."""
        own = getattr(self.finding, name)
        if own is None and self.bodies and None not in (known := [getattr(one, name) for one in self.bodies.values()]):
            own = of_bodies(known)
        return None if own is None else float(own)

    @property
    def source(self) -> Floats:
        """The source points, (n, 3) or (n, 2)."""
        return self.task.points.source

    @property
    def target(self) -> Floats:
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

    @cached_property
    def advice(self) -> str:
        """The status as a sentence, with what can be done about it for this problem.

        Between point sets in space it names the usual mistake that explains them, such as a left-handed set.
        """
        confidence = None if self.finding.all_confidence is None else self.confidence
        posed = self.status is Status.MATCHED and self.problem.min_for_pose > 0 and self.bodies is None
        told = advice(self.shown, confidence, self.stopped_early, posed and is_undetermined(self.poses))
        asked = isinstance(self.problem, Similarity) and self.status is Status.UNTRUSTED and self.bodies is None
        fits = self.diagnose(ADVISED).fits if asked and self.finding.reason is None else ()
        if fits and (fits[0].probability or 0.0) > 0.5:
            return f"no trustworthy match: {fits[0].mistake}; {fits[0].remedy}"
        return told if self.bodies else told + point_advice(self.finding, self.whole)

    @cached_property
    def poses(self) -> list[Pose | None]:
        """The most likely pose of each motion, with its covariance; see `Pose` for frames and units.

        Fitted to all matches of the motion by maximum likelihood, with the noise that was given or estimated. None for
        a motion with fewer matches than a pose needs (`Problem.min_for_pose`), or if no pose puts them in front of
        the camera. The covariance describes the effect of the noise if the assignment is right. A prior that holds is
        part of the fit; between two point sets such a pose has no χ² and no residuals.

        Raises
        ------
        InputError
            If the problem fits no poses, as derived problems, whose equations do not say what a pose is.
        """
        return finding_poses(self.finding)

    @cached_property
    def alternative_poses(self) -> list[list[Pose | None]]:
        """Poses of each of `alternatives`. With several motions, points keep the motion that they have here."""
        return fit_match_poses(self.task, [other for other, _ in self.alternatives], self.motion_labels)

    @cached_property
    def other_poses(self) -> list[tuple[Pose, float]]:
        """Other poses that fit the same matches, with their posterior probabilities, the most probable first.

        Nearly flat objects have a second one with reversed depth. If no pose is certain, the match is ambiguous, even
        if its assignment is certain. Empty for problems that have no camera pose.
        """
        return other_poses(self.finding)

    def poses_of(self, assignment: ArrayLike) -> list[Pose | None]:
        """Poses of any assignment (n,) between these points, −1 where unmatched: one for each body or motion.

        Raises
        ------
        InputError
            If it is not an assignment, and as `poses`.
        """
        one = check_assignment(assignment, self.task.shape)
        return fit_match_poses(self.task, [one], assignment_labels(self.task, self.motion_labels))[0]

    @property
    def pose(self) -> Pose | None:
        """The pose of the only body, None for problems without poses; for several bodies see `poses` and `bodies`."""
        poses = self.poses if self.problem.min_for_pose else []
        return poses[0] if len(poses) == 1 else None

    def diagnose(self, max_seconds: float = 20.0) -> Diagnosis:
        """Try the usual mistakes, such as a mirrored y or inward normals, and report which would explain the points.

        `Diagnosis.fits` names the mistakes with which the points match; ``print`` the result. ``max_seconds`` limits
        all trials together.
        """
        return try_mistakes(self, lambda finding: report(finding, seconds=0.0), max_seconds)

    def report(self, path: str | Path, **options: Any) -> None:
        """Write the match as one self-contained page for the browser, which needs no network.

        It shows points and camera in 3D, the image with residuals, the alternatives, poses, settings and versions, and
        needs the extra ``report``. Options: see `rootmatch.report.html.write_report`.

        Raises
        ------
        InputError
            If the file or the photograph cannot be used.
        RootmatchError
            If the extra is not installed.
        """
        if self.sightings is not None:
            raise InputError("report: a page cannot show the several images of a rig; see `sightings` and `poses`")
        from rootmatch.report.html import write_report  # plotly and jinja2 are needed here alone

        write_report(self, path, **options)


def report(finding: Finding, *, seconds: float, stopped_early: bool = False, whole: Finding | None = None) -> Match:
    """The public result of what was found in so many seconds: the only place that makes a `Match`."""
    told: dict[str, Any] = {"seconds": seconds, "stopped_early": stopped_early}
    bodies = {label: report(part, whole=finding, **told) for label, part in (finding.parts or {}).items()}
    return Match(finding=finding, bodies=bodies or None, whole=whole, **told)

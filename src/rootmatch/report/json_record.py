"""A match as a JSON record, for programs: ``rootmatch match --json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rootmatch.io.pose_files import finite_or_none, pose_record

if TYPE_CHECKING:
    from rootmatch.explain.diagnosis import Diagnosis, Trial
    from rootmatch.problems.pose_fit.pose import Pose
    from rootmatch.result import Match


def match_record(match: Match) -> dict[str, Any]:
    """The match as numbers, lists and strings that JSON can hold.

    Keys: ``assignment`` and ``motion_labels`` (lists of n, −1 unmatched), ``score`` (null if no hyper-edge was
    evaluated), ``margin``, ``probability`` and ``log_odds`` (null if there is none), ``confidence`` (list of n, of each
    match or unmatched point), ``alternatives`` (objects with ``assignment`` and ``score``, best first), ``status``
    (``"matched"``, ``"ambiguous"`` or ``"untrusted"``), ``prior_holds`` (null without one, or if nothing is trusted),
    ``converged``, ``stopped_early`` (whether the time limit ended it), ``seconds``, ``evaluated`` (hyper-edges),
    ``noise`` (σ in pixels, null if it differs by point),
    ``noise_factor`` and ``point_error`` (see `rootmatch.Match`), ``poses`` (one for each motion, null if it has none;
    null for problems that fit no poses; see `rootmatch.io.pose_record`), which alternatives have too, ``other_poses``
    (of the same assignment, or null: objects with ``pose`` and ``probability``), and of several bodies ``bodies``, by
    label what `body_record` tells. Indices are zero-based row numbers. A number that is not finite becomes null.
    """
    fits = bool(match.problem.min_for_pose)
    others = match.alternative_poses if fits else [None] * len(match.alternatives)
    record = {
        "assignment": match.assignment.tolist(),
        "score": finite_or_none(match.score),
        "margin": finite_or_none(match.margin),
        "probability": finite_or_none(match.probability),
        "log_odds": finite_or_none(match.log_odds),
        "confidence": [finite_or_none(value) for value in match.confidence.tolist()],
        "motion_labels": match.motion_labels.tolist(),
        "alternatives": [
            {"assignment": other.tolist(), "score": finite_or_none(score), "poses": _pose_records(poses)}
            for (other, score), poses in zip(match.alternatives, others, strict=True)
        ],
        "status": match.status.name.lower(),
        **({} if match.sightings is None else {"sightings": match.sightings.assignment.tolist()}),
        "prior_holds": match.prior_holds,
        "converged": match.converged,
        "stopped_early": match.stopped_early,
        "seconds": finite_or_none(match.seconds),
        "evaluated": int(match.evaluated),
        "noise": finite_or_none(match.noise) if isinstance(match.noise, int | float) else None,
        "noise_factor": finite_or_none(match.noise_factor),
        "point_error": finite_or_none(match.point_error),
        "poses": _pose_records(match.poses) if fits else None,
        "other_poses": [{"pose": pose_record(pose), "probability": likely} for pose, likely in match.other_poses]
        if fits
        else None,
    }
    if match.bodies is not None:
        told = {str(label): body_record(one, one.advice, one.probability) for label, one in match.bodies.items()}
        record["bodies"] = told
    return record


def body_record(match: Match, advice: str, probability: float | None) -> dict[str, Any]:
    """A body as numbers, lists and strings that JSON can hold.

    Keys: ``status``, ``advice`` (a sentence), ``prior_holds`` (null without one, or if nothing is trusted),
    ``stopped_early``, ``probability`` (null if there is none), ``pairs`` (source point, detection), ``pose`` (see
    `rootmatch.io.pose_record`; null if it is not known).
    """
    pose = told_pose(match)
    return {
        "status": match.status.name.lower(),
        "advice": advice,
        "prior_holds": match.prior_holds,
        "stopped_early": match.stopped_early,
        "probability": finite_or_none(probability),
        "pairs": match.pairs.tolist(),
        "pose": None if pose is None else pose_record(pose),
    }


def told_pose(match: Match) -> Pose | None:
    """The pose of one body, with what frames before tell; None where it is not known."""
    if match.fused_pose is not None:
        return match.fused_pose
    if match.status.name == "UNTRUSTED" or not match.problem.min_for_pose:
        return None
    return match.poses[0] if match.poses else None


def diagnosis_record(diagnosis: Diagnosis) -> dict[str, Any]:
    """What was tried, see `rootmatch.Match.diagnose`.

    Keys: ``fits``, the mistakes that would explain the points, the best first; ``given``, the input as it was given;
    ``left_out``, for how many mistakes there was no time. Of each ``mistake``, ``remedy``, ``status``, ``matched``
    (number of points), ``log_odds`` and ``probability`` (null if there is none).
    """
    fits = [_trial_record(one) for one in diagnosis.fits]
    return {"fits": fits, "given": _trial_record(diagnosis.given), "left_out": diagnosis.left_out}


def _trial_record(trial: Trial) -> dict[str, Any]:
    return {
        "mistake": trial.mistake,
        "remedy": trial.remedy,
        "status": trial.status.name.lower(),
        "matched": trial.matched,
        "log_odds": finite_or_none(trial.log_odds),
        "probability": finite_or_none(trial.probability),
    }


def _pose_records(poses: Sequence[Pose | None] | None) -> list[dict[str, Any] | None] | None:
    """Records of poses, None if there are none."""
    return None if poses is None else [None if pose is None else pose_record(pose) for pose in poses]

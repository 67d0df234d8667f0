"""The advice about a match: a sentence in the words of its problem."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.decide import MIN_PROBABILITY, TRUST, Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import ANOTHER, Misfit
from rootmatch.explain.inexact_points import alike_error
from rootmatch.explain.merged_detections import merged_advice
from rootmatch.explain.mistake import format_scaled
from rootmatch.explain.obvious_faults import TOGETHER, is_detected_twice, obvious_fault, unit_fault
from rootmatch.explain.predicted_poses import agrees_with_prior, contradicts_vertical, is_against_prior
from rootmatch.explain.silent_cameras import camera_advice, scale_advice, unit_advice
from rootmatch.explain.task import MatchingTask
from rootmatch.explain.two_view_decision import has_vague_axes, nothing_found_text
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.hypergraph.assignment import are_targets_disjoint
from rootmatch.model.priors import PRESENT_ODDS, probability
from rootmatch.problems.base import Problem
from rootmatch.problems.p3p import P3P
from rootmatch.problems.pose_fit.pose import Pose

ADVICE = {
    Status.MATCHED: "matched: the assignment is well supported and no other explains the points nearly as well",
    Status.AMBIGUOUS: (
        "ambiguous: another assignment explains the points nearly as well; see `alternatives`; {to_tell}, "
        "or add points that break the symmetry"
    ),
    Status.UNTRUSTED: "no trustworthy match: too few hyper-edges agree; check {to_check}, {to_change}",
}
"""Sentences with gaps for what the problem suggests to check and to add."""

PRIOR = "a `prior`"
CAUSES = "; usual causes are the lens calibration, motion during the exposure, a rolling shutter, and a bent model"
NOTED = 0.1
"""Probability from which a match that is not trusted is told to be possible. A round value."""
NOISY = 1.5
"""Factor on the stated σ that a sequence suggests from which it is told. A round value."""
UNDETERMINED = 1.0
"""Standard deviation of a rotation, radians, from which a pose does not tell it. A round value."""


def general_advice(
    status: Status, problem: Problem, to_tell: str | None = None, to_change: str = "raise the noise"
) -> str:
    """What a status means, and what can be done about it for a problem, or to tell poses of one task apart."""
    return ADVICE[status].format(to_tell=to_tell or problem.to_tell, to_check=problem.to_check, to_change=to_change)


def advice(
    finding: Finding,
    confidence: NDArray[np.float64] | None = None,
    stopped_early: bool = False,
    undetermined: bool = False,
) -> str:
    """The status of a finding as a sentence, with what can be done about it.

    ``stopped_early``: whether the time limit ended the search. ``undetermined``: see `is_undetermined`.
    """
    if finding.status is Status.UNTRUSTED and (reason := obvious_fault(finding.task) or finding.reason) is not None:
        return f"no trustworthy match: {reason}"
    if finding.status is Status.AMBIGUOUS and (reason := unit_fault(finding.task)) is not None:
        return f"ambiguous: {reason}"
    unsure = 0 if confidence is None else int((confidence < MIN_PROBABILITY).sum())
    if (of_bodies := _bodies_text(finding)) is not None:
        text = of_bodies
    elif finding.status is Status.UNTRUSTED:
        text = _untrusted_text(finding, stopped_early)
    elif finding.status is Status.AMBIGUOUS and finding.reason is not None:
        text = f"ambiguous: {finding.reason}; more frames that show it will settle this, or give a `Pose` as `prior`"
    elif finding.status is Status.AMBIGUOUS:
        text = _ambiguous_text(finding, unsure, stopped_early)
    else:
        text = general_advice(finding.status, finding.task.problem)
        if unsure:
            text += f"; {unsure} of the points may have another detection, or none: see `confidence`"
        if finding.point_error:
            text += (
                f"; it fits only if the points of the model are off by {finding.point_error:.2g} on each axis: give "
                "`source_noise=` if they are, or a larger `noise=` if the detections are"
            )
        text += scale_advice(finding) + camera_advice(finding)
        if undetermined:
            text += "; these points do not determine the pose in every direction: see its covariance"
        if finding.sequence_factor >= NOISY:
            text += (
                f"; judging by the frames so far, the noise is {finding.sequence_factor:.1f} times as large as "
                "given, or a similar object is followed instead"
            )
        if finding.motion_factor > 1.0:
            text += f"; it accelerates {finding.motion_factor:g} times as much as `MotionOptions` say or more: state it"
    if finding.status is not Status.MATCHED and is_detected_twice(finding.task):
        text += (
            f"; most detections have another within {TOGETHER:.0f} σ: if the detector reports each point twice, "
            "merge such pairs first, as the second counts as clutter"
        )
    text += merged_advice(finding)
    if agrees_with_prior(finding) is False:
        against, check = _contradiction_texts(finding)
        text += f"; this pose contradicts {against}{', which was ignored' * (not finding.prior_holds)}; {check}"
    told = "max_seconds" in text or not stopped_early
    return text if told else f"{text}; `max_seconds` ended the search early"


def is_undetermined(poses: Sequence[Pose | None]) -> bool:
    """Whether the covariance of any pose leaves a rotation open, as points on a line leave the turn about it."""
    every = [(one.covariance, 3 if len(one.t) == 3 else 1) for one in poses if one is not None]
    largest = (np.linalg.eigvalsh(known[:size, :size])[-1] for known, size in every if known is not None)
    return any(float(one) > UNDETERMINED**2 for one in largest)


def _bodies_text(finding: Finding) -> str | None:
    """Which of several bodies are not trusted; None if all are, or if none is found at all."""
    parts = finding.parts or {}
    untrusted = {label: part for label, part in parts.items() if part.status is Status.UNTRUSTED}
    chance = {label: part.probability for label, part in untrusted.items() if _is_maybe_chance(part)}
    misfits = [label for label, part in untrusted.items() if math.isinf(part.facts.false_alarms) and _is_there(part)]
    found = [label for label, part in parts.items() if part.status is not Status.UNTRUSTED]
    if finding.status is Status.MATCHED or not (chance or found or misfits):
        return None
    unsure = [label for label in found if parts[label].status is Status.AMBIGUOUS]
    told = [f"body {label} could be chance (probability {p:.3g})" for label, p in chance.items()]
    told += [f"body {label} does not fit" for label in misfits]
    told += [f"body {label} is not found" for label in parts if label not in {*chance, *found, *misfits}]
    told += [f"body {label} is ambiguous" for label in unsure]
    told += [f"body {label} is matched" for label in found if label not in unsure]
    start = "no trustworthy match of all bodies" if finding.status is Status.UNTRUSTED else "ambiguous"
    return f"{start}: {', '.join(told)}; see the advice of each in `bodies`"


def _untrusted_text(finding: Finding, stopped_early: bool) -> str:
    """Why a finding is not trusted: the noise, chance, or that nothing was found."""
    task, facts, factor = finding.task, finding.facts, finding.noise_factor
    problem, causes = task.problem, CAUSES if task.problem.takes_prior else ""
    if (error := finding.point_error or alike_error(finding)) > 0.0:
        return (
            f"no trustworthy match: what was found fits if the points of the model are off by {error:.2g} on each "
            "axis, but an object of nearly the same shape, or another pose, explains as much; check the model, and "
            "give `source_noise=`, or a larger `noise=`, if such errors are realistic"
        )
    if factor is not None and TRUST.noise_factor <= factor <= TRUST.max_named and _is_noise_larger(finding):
        told = format_scaled(task.noise, factor)
        if _is_pose_with_larger_noise(finding):
            exact = problem.takes_prior and task.points.source_covariance is None
            told += ", or `source_noise=` if the model is inexact" if exact else ""
            return (
                f"no trustworthy match: judging by the residuals, the noise is {factor:.1f} times as large as given, "
                f"or the pose is wrong; give {told}, and check {problem.to_check}{unit_advice(finding) or causes}"
            )
        if not has_vague_axes(problem):
            return (
                "no trustworthy match: no pose fits, and even with "
                f"{factor:.1f} times the stated noise, which the residuals suggest, this could be chance; "
                f"check {problem.to_check}; set {told} only if that is realistic{causes}"
            )
    if _is_maybe_chance(finding):
        chance, minimum = _format_distinct(facts.probability or 0.0, facts.min_probability)
        what = "chance" if 2.0 * math.exp(min(finding.another, 0.0)) < 1.0 - (facts.probability or 0.0) else ANOTHER
        contradicted, check = _contradiction_texts(finding)
        against = f"it contradicts {contradicted} and is far more probable without it; {check}, or "
        to_give = _enumerate_inputs([*_missing_inputs(task), "fewer stray detections"])
        return (
            f"no trustworthy match: what was found could be {what} (probability {chance}, `min_probability` {minimum})"
            f"; {against if is_against_prior(finding) else ''}{to_give}"
        )
    if stopped_early:
        return (
            "no trustworthy match: `max_seconds` ended the search before it found anything that chance does not "
            f"explain; give more time, or check {problem.to_check}"
        )
    if finding.is_cut:
        return (
            "no trustworthy match: `search_budget` ended the search of this frame before it found anything that "
            f"chance does not explain; raise it in `TrackingOptions`, or check {problem.to_check}"
        )
    if facts.present is not None:
        whole = facts.missed <= TRUST.missed  # a search that ended by itself
        seen = "" if task.rig is None else "; `diagnose` tries the usual mistakes about a rig"
        to_give = _enumerate_inputs([*_missing_inputs(task), "more points or detections"])
        return (
            f"no trustworthy match: {nothing_found_text(problem)}; check the noise, {problem.to_check}, or {to_give}"
            f"{seen if whole else f', or {finding.longer_search}: not all poses were tried'}"
        )
    in_noise = task.affinity.residual.kind in NOISE_KINDS  # σ has no part in the others
    to_change = "raise the noise" if in_noise else "try another `rho`"
    return f"{general_advice(Status.UNTRUSTED, problem, to_change=to_change)}, or {finding.longer_search}"


def _contradiction_texts(finding: Finding) -> tuple[str, str]:
    """What a finding contradicts, and what to check of that: a prediction of a tracker's own is not what was given."""
    if contradicts_vertical(finding):
        return "the measured vertical", "check both verticals, and `vertical_noise`"
    if finding.task.rivals.places and not finding.contradicted:
        return "the prediction from earlier frames", "check their times, and the speeds that `MotionOptions` allows"
    return "the prior", "check the prior and its σ"


def _is_there(finding: Finding) -> bool:
    """Whether something is there with the probability that was asked for."""
    return finding.facts.present is not None and finding.facts.present >= finding.facts.min_probability


def _is_maybe_chance(finding: Finding) -> bool:
    """Whether what was found may be there, with less than the probability that was asked for."""
    return finding.facts.present is not None and not _is_there(finding) and (finding.facts.probability or 0.0) >= NOTED


def _format_distinct(less: float, more: float) -> tuple[str, str]:
    """Two probabilities with as many digits as it takes to see that they differ."""
    digits = next((k for k in range(3, 17) if f"{less:.{k}g}" != f"{more:.{k}g}"), 17)
    return f"{less:.{digits}g}", f"{more:.{digits}g}"


def _ambiguous_text(finding: Finding, unsure: int, stopped_early: bool) -> str:
    """Why a finding is ambiguous: what the search left out, doubtful points, several poses, or copies."""
    task = finding.task
    to_give, to_tell = _missing_inputs(task), _disambiguation_text(task)
    if finding.facts.incomplete:
        motions = len(np.unique(finding.motion_labels[finding.motion_labels >= 0]))
        return (
            f"ambiguous: {motions} of {task.options.motions} motions were found, and some of the points left may "
            f"belong to another one; see `confidence`, {_enumerate_inputs([*to_give, 'more detections'])}, or ask "
            "for fewer motions"
        )
    if _is_unexcluded(finding):
        missed = "another pose that explains as much"
        if stopped_early:
            return (
                f"ambiguous: `max_seconds` ended the search before it could exclude {missed}; "
                f"{_enumerate_inputs(['more time', *to_give])}"
            )
        if finding.matched_count <= task.minimal:
            return (
                "ambiguous: nothing better was found, but no search can try every pose that explains so few points; "
                f"{_enumerate_inputs([*to_give, 'more detections'])}"
            )
        return (
            f"ambiguous: nothing better was found, but the search ended before it could exclude {missed}; "
            f"{_enumerate_inputs([*to_give, 'fewer stray detections'])}, or {finding.longer_search}"
        )
    prior = ", or give a `prior`" if PRIOR in to_give and to_tell != _enumerate_inputs([PRIOR]) else ""
    of, where = ("points", "`confidence`") if unsure else ("sightings", "`sightings`")  # of points that others show
    every = np.ones(1) if finding.all_confidence is None else finding.all_confidence
    unsure = unsure or int((every < MIN_PROBABILITY).sum())
    if unsure and finding.is_pose_certain:
        return (
            f"ambiguous: the pose is certain, but {unsure} of the {of} may have another detection, or none; see "
            f"{where}, or {to_tell}"
        )
    told = finding.posterior or finding.labellings
    if told is not None and told.copies > 1:
        shown = "image" if task.problem.takes_prior else "measurement"
        return (
            f"ambiguous: {told.copies} bodies are identical, and no {shown} tells which is where; see "
            "`alternatives`, or give a `prior` of each, or points that tell them apart"
        )
    if _is_elsewhere(finding):
        return (
            "ambiguous: the object, or one that looks like it, is in several places, and any of them may be the "
            f"right one; see `alternatives`{prior or (', or ' + to_tell)}{unit_advice(finding)}{camera_advice(finding)}"
        )
    if _is_assignment_certain(finding):
        return (
            "ambiguous: the matches are certain, but several poses fit them, as happens when the points are nearly "
            f"coplanar; see `other_poses`, {'' if prior else 'or '}{to_tell}{prior}"
        )
    if not len(finding.others) and finding.probability is not None:
        chance, minimum = _format_distinct(finding.probability, finding.facts.min_probability)
        return (
            "ambiguous: no other assignment comes close, but the doubts about single matches add up: all of them are "
            f"right with a probability of {chance}, less than asked for (`min_probability` {minimum}); keep those of "
            f"high `confidence`, or {to_tell}"
        )
    return general_advice(Status.AMBIGUOUS, task.problem, to_tell)


def _disambiguation_text(task: MatchingTask) -> str:
    """What may tell apart what the status calls ambiguous, of what the task lacks."""
    if not task.problem.takes_normals:
        return task.problem.to_tell
    lacking = _missing_inputs(task)
    return _enumerate_inputs([one for one in lacking if one != PRIOR] or lacking or ["more detections"])


def _missing_inputs(task: MatchingTask) -> list[str]:
    """What would tell poses apart and was not given."""
    problem, lacking = task.problem, []
    if problem.takes_normals and task.points.normals is None:
        lacking.append("normals")
    told = task.prior_pose is not None or (task.known is not None and (task.known.vertical or task.known.rotation))
    if isinstance(problem, P3P) and not told:
        lacking.append("a vertical (`UP2P`)")
    if (problem.takes_prior or problem.takes_motion_prior) and not task.has_prior:
        lacking.append(PRIOR)
    return lacking


def _enumerate_inputs(things: list[str]) -> str:
    """An enumeration of what to give."""
    return "give " + ", or ".join([", ".join(things[:-1]), things[-1]] if len(things) > 1 else things)


def _is_noise_larger(finding: Finding) -> bool:
    """Whether residuals as large as a finding's are rare where σ is right: those of few matches are not."""
    factor, dof = finding.noise_factor, finding.noise_dof
    return factor is not None and Misfit(factor**2, factor, dof).chance < TRUST.noise_chance


def _is_pose_with_larger_noise(finding: Finding) -> bool:
    """Whether a finding would be beyond chance if its pose is right and σ is what its residuals say."""
    factor, log_odds = finding.noise_factor, finding.log_odds
    if factor is None or log_odds is None:
        return True
    odds = PRESENT_ODDS + Misfit(factor**2, factor, finding.noise_dof).rescaled_log_odds(log_odds)
    return probability(odds) >= finding.facts.min_probability


def _is_unexcluded(finding: Finding) -> bool:
    """Whether an ambiguous finding would be trusted, had its search looked for other poses long enough."""
    facts = finding.facts
    if facts.missed <= TRUST.missed:
        return False
    if finding.posterior is not None or finding.labellings is not None:
        return finding.is_pose_certain
    if facts.probability is not None:
        return facts.probability >= facts.min_probability
    return facts.lead is None or facts.lead >= TRUST.margin


def _is_elsewhere(finding: Finding) -> bool:
    """Whether the best alternative has none of the same detections."""
    first, problem = finding.assignment, finding.task.problem
    known = (problem.takes_prior or problem.takes_motion_prior) and len(finding.others) and (first >= 0).any()
    return bool(known and are_targets_disjoint(np.array(finding.others[:1]), first)[0])


def _is_assignment_certain(finding: Finding) -> bool:
    """Whether the assignment is as probable as a match has to be, whatever its pose."""
    told, probability = finding.posterior, finding.probability
    sure = probability is not None and probability >= finding.facts.min_probability
    return sure and told is not None and not finding.is_pose_certain

"""The advice about a match: a sentence in the words of its problem."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.decide import MIN_PROBABILITY, TRUST, Status
from rootmatch.explain.finding import Finding
from rootmatch.hypergraph.assignment import apart_from
from rootmatch.problems.base import Problem

ADVICE = {
    Status.MATCHED: "matched: the assignment is well supported and no other explains the points nearly as well",
    Status.AMBIGUOUS: (
        "ambiguous: another assignment explains the points nearly as well; see `alternatives`, {to_tell}, "
        "or add points that break the symmetry"
    ),
    Status.UNTRUSTED: (
        "no trustworthy match: too few hyper-edges agree; check {to_check}, raise the noise, "
        "or evaluate more hyper-edges"
    ),
}
"""Sentences with gaps for what the problem suggests to check and to add."""


def advice_on(status: Status, problem: Problem) -> str:
    """What a status means, and what can be done about it for a problem."""
    return ADVICE[status].format(to_tell=problem.to_tell, to_check=problem.to_check)


def advice(finding: Finding, confidence: NDArray[np.float64] | None = None, stopped_early: bool = False) -> str:
    """The status of a finding as a sentence, with what can be done about it.

    Parameters
    ----------
    finding : Finding
    confidence : (n,) array, optional
        Confidence in each match, if the status needed it.
    stopped_early : bool
        Whether the time limit ended the search.
    """
    if finding.reason is not None:
        return f"no trustworthy match: {finding.reason}"
    problem, noise, factor = finding.task.problem, finding.task.noise, finding.noise_factor
    text = advice_on(finding.status, problem)
    blamed = factor is not None and TRUST.noise_factor <= factor <= TRUST.most_named
    if blamed and finding.status is Status.UNTRUSTED:
        assert factor is not None
        told = f"noise={factor * noise:.2g}" if isinstance(noise, int | float) else "a larger noise="
        text = (
            f"no trustworthy match: by its residuals the noise is {factor:.1f} times as large as given; "
            f'give {told}, or noise="auto", and check {problem.to_check}'
        )
    unsure = 0 if confidence is None else int((confidence < MIN_PROBABILITY).sum())
    if finding.status is Status.AMBIGUOUS and unsure and _is_pose_certain(finding):
        text = (
            f"ambiguous: the pose is certain, but for {unsure} of the points it is not which image they have, if any; "
            f"see `confidence`, or {problem.to_tell}"
        )
    if finding.status is Status.AMBIGUOUS and _is_assignment_certain(finding):
        text = (
            "ambiguous: the matches are certain, but several poses fit them, as where the points are nearly flat; "
            f"see `other_poses`, {problem.to_tell}, or give a `prior`"
        )
    if finding.status is Status.AMBIGUOUS and _is_elsewhere(finding):
        text = (
            "ambiguous: the object, or one that looks like it, is in several places, and any may be the one asked for; "
            "see `alternatives`, or give a `prior`"
        )
    if finding.status is Status.MATCHED and unsure:
        text += f"; for {unsure} of the points it is not certain which image they have, if any: see `confidence`"
    if finding.prior_holds is False:
        known = "what was known of the pose" if finding.task.known is not None else "the predicted pose"
        text += f"; {known} was wrong, this one was found without it"
    return f"{text}; max_seconds ended it before it was finished" if stopped_early else text


def _is_elsewhere(finding: Finding) -> bool:
    """Whether the best alternative has none of the same detections."""
    first, of_poses = finding.assignment, finding.task.problem.takes_prior or finding.task.problem.takes_motion_prior
    if not of_poses or not len(finding.others) or not (first >= 0).any():
        return False
    return bool(apart_from(np.array(finding.others[:1]), first)[0])


def _is_assignment_certain(finding: Finding) -> bool:
    """Whether the assignment is as probable as a match has to be, whatever its pose."""
    told, probability = finding.posterior, finding.probability
    sure = probability is not None and probability >= finding.facts.min_probability
    return sure and told is not None and not _is_pose_certain(finding)


def _is_pose_certain(finding: Finding) -> bool:
    """Whether one pose is as probable as a match has to be, whatever its matches."""
    told = finding.posterior
    return told is not None and bool((told.probabilities[:1] >= finding.facts.min_probability).any())

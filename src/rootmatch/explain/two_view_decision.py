"""From what was found of two images to what the model of their geometry says of it, and to the facts of a status.

The rule is that of the image of a body: the images show the same points with the probability that is asked for, and so
do enough of the matches together; they are ambiguous if they show the same points, but not enough matches are sure.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rootmatch.arrays import Floats, Integers
from rootmatch.cameras.base import CameraModel
from rootmatch.deadline import OutOfTime
from rootmatch.explain.decide import TRUST, Facts, Status
from rootmatch.explain.finding import Finding, make_unjudged
from rootmatch.explain.goodness_of_fit import Misfit, discount_misfit, is_misfit
from rootmatch.explain.image_decision import KEPT
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.affinity import NOISE_KINDS
from rootmatch.model.clutter import Clutter, clutter_areas, estimate_clutter
from rootmatch.model.detection_model import HIGHEST_RATE
from rootmatch.model.posterior import joint_probabilities, surest_matches
from rootmatch.model.priors import COPY, PRESENT
from rootmatch.model.two_view_fit import drop_similar
from rootmatch.model.two_view_losses import displaced_labellings, log_loss_probability
from rootmatch.model.two_view_model import TwoViewModel
from rootmatch.model.two_view_places import reweigh_by_crowding
from rootmatch.model.two_view_posterior import TwoViewPosterior, sample_two_view_posterior
from rootmatch.model.two_view_samples import fit_likeliest, fit_log_evidence
from rootmatch.problems.base import Problem
from rootmatch.samplers.base import SampledTensor
from rootmatch.samplers.two_views.relative_hypothesis import OTHER, shared_match_share
from rootmatch.solvers.base import Solution

MINIMUM = math.log(1e-6)
"""Log-odds of rivals below which there are none. By construction: far below what is told."""
Rivals = tuple[Integers, Floats]
"""Labellings (K, n) that may be right in the place of the one reported, and the odds (K,) of each."""
BESIDE = 2
"""First distinct ones that a search named which are fitted beside displaced ones. A round value."""
AGREED = 0.5
"""Probability from which the likeliest assignment is told; else the one with the most matches expected to be right."""


def make_two_view_model(task: MatchingTask) -> TwoViewModel | None:
    """The model of a task of two views and one motion, in units of the noise; None for every other one."""
    in_noise = task.affinity.residual.kind in NOISE_KINDS
    if not in_noise or task.options.is_paper or task.options.motions != 1:
        return None
    problem = task.problem
    if problem.small_baseline > 0.0:  # a prior of hyper-edges, which the model of how far away points are replaces
        problem = replace(problem, small_baseline=0.0)  # type: ignore[type-var]
    views = problem.two_views(task.points)
    if views is None:
        return None
    tilt = math.sqrt(2.0) * float(getattr(task.problem, "axis_noise", 0.0))
    camera, points = task.problem.camera, task.points  # type: ignore[attr-defined]
    crowds, _ = _crowds(camera, points.source, points.source_noise)
    clutter, sigma = _crowds(getattr(task.problem, "camera2", None) or camera, points.target, points.target_noise)
    log_weights = task.log_weights
    if task.allowed is not None:
        log_weights = np.where(task.allowed, 0.0 if log_weights is None else log_weights, -np.inf)
    rate = task.options.detection_rate
    return TwoViewModel(
        views.source.T,
        views.target.T,
        views.source_variance - tilt**2,
        views.target_variance,
        # a pixel is seen under the angle whose square is that of its noise over that in pixels
        clutter.log_density - np.log(views.target_variance) + 2.0 * np.log(sigma),
        planar=views.planar,
        tilt=tilt,
        log_weights=log_weights,
        detection_rate=None if rate is None else min(rate, HIGHEST_RATE),
        weighs_parts=task.weighs_parts,
        present=PRESENT if task.present is None else task.present,
        crowds=crowds,
    )


def _crowds(camera: CameraModel, points: Floats, noise: Floats) -> tuple[Clutter, Floats]:
    """How points of an image crowd, and their σ in it."""
    pixels, sigma = camera.chart(points, noise)[1:]
    areas = camera.image_areas(points)
    return estimate_clutter(pixels, sigma, clutter_areas(pixels, sigma) if areas is None else areas), sigma


def assess_two_views(
    task: MatchingTask, model: TwoViewModel, sampled: SampledTensor, solution: Solution | None
) -> Finding:
    """The finding of what a search named, or a solver: judged by the model of two views."""
    named, base = make_unjudged(task, sampled, solution)
    every = np.array(named, np.int64).reshape(-1, task.shape[0])
    try:
        told = reweigh_by_crowding(sample_two_view_posterior(model, every, task.options.seed))
        rivals = rival_labellings(model, told, every if sampled.repeated else every[:0], task.options.seed)
    except OutOfTime:
        return base
    found = two_view_finding(base, told, sampled.missed, rivals)
    return replace(found, named=named) if sampled.repeated else found


def rival_labellings(model: TwoViewModel, told: TwoViewPosterior, named: Integers, seed: int) -> Rivals:
    """Labellings (K, n) that may be right and not the one reported, a period away or half a turn, and their odds (K,).

    Of what a search named (M, n), those that have little in common with it, and it displaced along the scene. If the
    images show the same points in such a pose beyond any accident, either may be right, however much better one fits,
    up to the points that it loses: with the odds B of the images without the matches reported, κ of a copy, and the
    odds r of those losses, the odds of a rival are r κ B / (1 + κ B), B less where what is displaced fits worse, and of
    all together no more than 1.
    """
    first = reported_assignment(told)
    own = np.flatnonzero(first >= 0)
    if not len(own) or not len(named):
        return named[:0], np.zeros(0)
    drawn, weights, _ = told.parts[0]
    along = displaced_labellings(model, drawn.poses.take(np.array([weights.argmax()])), first)
    elsewhere = named[shared_match_share(named, first) <= OTHER]
    if not len(elsewhere) and not len(along):
        return elsewhere, np.zeros(0)
    log_weights = np.zeros(model.shape) if model.log_weights is None else model.log_weights.copy()
    log_weights[own, first[own]] = -np.inf
    rest = np.concatenate([drop_similar(elsewhere)[:BESIDE].reshape(-1, len(first)), along, elsewhere])
    rest = np.where(rest == first, -1, rest)
    # the search compares poses fitted to the points, and without the volume of all others even one of four by accident
    # looks as if it were there
    other = sample_two_view_posterior(replace(model, log_weights=log_weights), rest, seed, alike=False)
    copy = other.log_evidence + math.log(COPY)
    if copy < MINIMUM:
        return elsewhere[:0], np.zeros(0)
    # what is displaced is there by as much as it fits worse than the best
    along = np.concatenate([other.proposals[:1], along])
    value = fit_log_evidence(model, fit_likeliest(model, along))
    copies = np.concatenate([copy + np.minimum(value - value[0], 0.0), np.full(len(elsewhere), copy)])
    elsewhere = np.concatenate([along, elsewhere])[copies > MINIMUM]
    lost = log_loss_probability(model, np.array([first, *elsewhere]))
    odds = np.exp(np.minimum(lost[1:] - lost[0], 0.0)) / (1.0 + np.exp(-copies[copies > MINIMUM]))
    return elsewhere, odds / max(float(odds.sum()), 1.0)


def reported_assignment(told: TwoViewPosterior) -> Integers:
    """The assignment (n,) that a posterior with proposals tells."""
    if not len(told.proposals):
        return np.full(told.model.shape[0], -1, np.int64)
    return told.proposals[0] if told.shares[0] >= AGREED else told.likeliest_pairs


def two_view_finding(base: Finding, told: TwoViewPosterior, missed: float, rivals: Rivals) -> Finding:
    """A finding with assignment, facts and confidence as a posterior and its `rival_labellings` tell them."""
    minimum = base.task.options.required_probability
    present = min(told.presences)
    facts = Facts(present=present, contested=True, min_probability=minimum, missed=missed)
    first = reported_assignment(told)
    if not len(told.proposals):
        nothing = first
        return replace(
            base,
            assignment=nothing,
            others=[],
            facts=replace(facts, probability=told.assignment_probability(nothing), lead=0.0),
            scores=[0.0],
            confidence=told.confidence_in(nothing),
        )
    share = 1.0 / (1.0 + float(rivals[1].sum()))
    probability = share * told.assignment_probability(first)
    confidence = told.confidence_in(first) * np.where(first >= 0, share, 1.0)
    fault = Misfit.of(*told.chi2_and_dof(first))
    matched = np.flatnonzero(first >= 0)
    # matches of one motion do not depend on the presence of others
    beside = told.present / present if present > 0.0 else 1.0
    kept = matched[surest_matches(confidence[matched] / beside, 1.0 - minimum / beside)]
    motions = told.label_motions(first)
    counts = [(int((motions[some] == m).sum()) for some in (kept, matched)) for m in range(len(told.presences))]
    enough = all(sure >= max(base.task.problem.minimal + 1, KEPT * own) for sure, own in counts)
    if enough and missed <= TRUST.missed:
        facts = replace(facts, contested=False, sure_of_the_rest=True)
    facts = replace(facts, false_alarms=math.inf if is_misfit(fault) else -math.inf)
    if replace(base, facts=facts).status is Status.MATCHED:
        # of a large assignment more are known than are right together
        highest = float(confidence[kept].max())
        few = share * told.present * joint_probabilities(confidence[kept] / highest, minimum)
        while (together := max(share * told.together(first, kept), float(few[-1]))) < minimum and len(kept) > 1:
            kept, few = kept[:-1], few[:-1]
        sure = np.full_like(first, -1)
        sure[kept] = first[kept]
        probability = together if len(kept) < len(matched) else max(probability, together)
        first, confidence = sure, np.where((sure < 0) & (first >= 0), told.unmatched, confidence)
    different = ((told.proposals >= 0) & (told.proposals != first)).any(axis=1)
    others = [
        (other, share * told.assignment_probability(other)) for other in told.proposals[different][: TRUST.alternatives]
    ]
    others += [(other, share * odds * told.present) for other, odds in zip(*rivals, strict=True)]
    others.sort(key=lambda one: -one[1])
    found = replace(
        base,
        assignment=first,
        others=[other for other, _ in others[: TRUST.alternatives]],
        other_probabilities=[chance for _, chance in others[: TRUST.alternatives]],
        facts=replace(facts, probability=probability),
        soft=told.present * told.marginals if base.soft is None else base.soft,
        confidence=confidence,
        log_odds=told.assignment_log_odds(first),
        noise_factor=fault.sigma,
        noise_dof=fault.dof,
    )
    return discount_misfit(found, fault)


def has_vague_axes(problem: Problem) -> bool:
    """Whether the common direction of two images is known so little that a search loses poses by that."""
    if float(getattr(problem, "axis_noise", 0.0)) <= 0.0:
        return False
    from rootmatch.samplers.two_views.covering_sets import NEAR  # slow to import

    return bool(problem.tilt_variance > NEAR**2)  # type: ignore[attr-defined]


def nothing_found_text(problem: Problem) -> str:
    """What it means that a search ended by itself and found nothing."""
    if not has_vague_axes(problem):
        return "no pose explains more of the points than chance would"
    return (
        "chance explains all that was found, but the search may have missed the pose, as the axes are only known to "
        f"{math.degrees(problem.axis_noise):.2g}°; "  # type: ignore[attr-defined]
        "give a smaller `axis_noise` if that is realistic"
    )

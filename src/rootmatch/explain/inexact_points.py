"""Points of a body that are off though nobody said so, as those of a drawing that is not quite what was built.

What does not fit the body as given may be the body with points that are off by a small part of its size, or something
else of nearly its shape. The first is the model with a noise of the points, of one of a few sizes.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.explain.goodness_of_fit import Misfit, is_misfit
from rootmatch.explain.image_decision import image_finding, mode_misfit
from rootmatch.explain.image_hypotheses import Candidate, propose_predicted
from rootmatch.explain.in_time import final_deadline
from rootmatch.explain.task import MatchingTask
from rootmatch.frozen import copy_with
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_poses
from rootmatch.model.image_alike import (
    ERRORS,
    LOG_ALIKE,
    LOG_INEXACT,
    LOG_PRIOR,
    OWN,
    perturb_points,
    residual_log_gains,
)
from rootmatch.model.mode_search import HOPELESS, find_modes
from rootmatch.model.modes import empty_modes
from rootmatch.model.priors import NOISE_FREEDOM, WRONG_MODEL, probability
from rootmatch.model.smooth_errors import smooth_error_log_odds
from rootmatch.problems.pose_fit.reference_point import body_radius

SIZES = np.geomspace(float(ERRORS[0]) * 10.0**-0.2, float(ERRORS[-1]) * 10.0**0.2, 4 * len(ERRORS))
"""Sizes of errors, over the body's root mean square radius, by which a pose is told: four about each of `ERRORS`, each
as probable as the others. If these were only those that `ERRORS` allows a body, poses would be told too sure."""


def allow_point_errors(found: Finding, task: MatchingTask, *, missed: float = 0.0) -> Finding:
    """A finding of one body by `image_finding`, or that with points which are off, where these explain more."""
    if found.alike is None and not (found.noise_factor or 0.0) > 1.0:
        return found  # as it nearly always is
    model, misfit = found.model, Misfit.of_finding(found)
    by_fit = misfit is not None and misfit.sigma > 1.0
    exact = task.points.source_covariance is None and not task.noise_is_estimated and task.problem.takes_source_noise
    if model is None or misfit is None or not (by_fit or misfit.alike is not None) or not exact:
        return found
    of_rig = len(model.images) > 1
    before = LOG_INEXACT + np.array(task.log_inexact or (0.0,) * OWN)
    gains = before + (-np.inf if misfit.alike is None else misfit.alike[:OWN])
    larger = by_fit and not of_rig
    if larger and float(before.max()) + misfit.rescaled_log_odds(0.0) >= 0.0:  # of errors of any size
        gains = np.maximum(gains, before + error_gains(found))
    which = int(np.argmax(gains))
    if gains[which] < 0.0:
        return found
    with final_deadline().within():
        return _assume_point_errors(found, task, missed, before, which)
    return found


def _assume_point_errors(found: Finding, task: MatchingTask, missed: float, before: Floats, which: int) -> Finding:
    """A finding of the body with points that are off by one of `ERRORS`, if that holds.

    ``before``: log-odds (OWN,) of such errors; ``which``: of them the most probable.
    """
    _, model = found.posterior_and_model
    error = float(ERRORS[which]) * body_radius(task.points.source)
    body = _make_inexact_body(found, task, error)
    # in one image `_inexact_probability` counts what is beside points without a match
    several = len(model.images) > 1
    again = image_finding(copy_with(found, task=body.task), body.alone(), body, missed=missed, beside=several)
    if again.status is Status.UNTRUSTED or again.posterior is None:
        return found
    if several and is_misfit(mode_misfit(model, again.posterior.modes, again.mode)):
        return found  # the pose has taken up more of such errors than its residuals tell
    own = _inexact_probability(found, again, before, which)
    present = None if again.facts.present is None else own * again.facts.present
    return _average_error_sizes(again.with_facts(present=present).scale_probability(own), task, model, error)


def _average_error_sizes(again: Finding, task: MatchingTask, exact: DetectionModel, minimum: float) -> Finding:
    """A finding of a body with points that are off, in its pose by all sizes of these errors.

    The few of `ERRORS` decide what is in view. How large the errors are is what the matches tell; but as a pose takes
    up what is off alike, they are as large as decided (``minimum``) or larger. ``exact``: the model without errors.
    """
    told, _ = again.posterior_and_model
    modes, k, sizes = told.modes, again.mode, SIZES * exact.radius
    own = modes.take(slice(k, k + 1))
    pose = own.assignments, own.rotation, own.position
    odds = np.array([settle_poses(perturb_points(exact, one), *pose)[0].log_odds[0] for one in sizes.tolist()])
    error = max(float(np.sqrt(np.exp(odds - np.logaddexp.reduce(odds)) @ sizes**2)), minimum)
    model = perturb_points(exact, error)
    found, at = settle_poses(model, *pose)
    own = own._replace(rotation=at.rotation, position=at.position, covariance=found.covariance)
    told = copy_with(told, modes=modes.take(slice(k)).and_(own).and_(modes.take(slice(k + 1, None))))
    noisy = copy_with(again.task, points=task.problem.with_source_noise(task.points, error))
    return copy_with(again, task=noisy, model=model, posterior=told, point_error=error)


def alike_error(found: Finding) -> float:
    """By how much the points of a body before a rig would be off on each axis; 0 unless that explains more."""
    if found.alike is None or found.model is None or len(found.model.images) <= 1:
        return 0.0
    odds = LOG_PRIOR + found.alike
    return float(ERRORS[odds.argmax()] * found.model.radius) if odds.max() > 0.0 else 0.0


def error_gains(found: Finding) -> Floats:
    """Log-odds (E,) that points are off by each of `ERRORS`, by the residuals of a finding, to first order.

    Between two point sets, where something is near a point without a match, by that as well.
    """
    if found.labellings is not None:
        return _set_error_gains(found)
    model, misfit = found.model, Misfit.of_finding(found)
    if model is None or misfit is None or not misfit.dof:
        return np.zeros(OWN)
    residuals = misfit.squared, misfit.moved
    return residual_log_gains(model.noise_freedom, residuals, misfit.dof, ERRORS[:OWN] * model.radius)


def _set_error_gains(found: Finding) -> Floats:
    """The same between two point sets."""
    points, own = found.task.points, found.assignment >= 0
    if found.alike is not None:
        return found.alike[:OWN]
    if not found.noise_dof or found.noise_factor is None:
        return np.zeros(OWN)
    clouds = found.task.problem.point_clouds(points)
    assert clouds is not None
    moved = float((1.0 / (clouds.source_variance[own] + clouds.target_variance[found.assignment[own]])).mean())
    squared, errors = found.noise_dof * found.noise_factor**2, ERRORS[:OWN] * body_radius(points.source)
    return residual_log_gains(NOISE_FREEDOM, (squared, moved), found.noise_dof, errors)


def noise_factor(found: Finding) -> float | None:
    """`Finding.noise_factor` by the noise that was stated: without the points' errors, which nobody stated."""
    factor = found.noise_factor
    if found.point_error and found.model is not None and found.posterior is not None:
        factor = mode_misfit(copy_with(found.model, source_covariance=None), found.posterior.modes, found.mode).sigma
    return None if factor is None or math.isnan(factor) else factor  # a pose that takes up all has no residuals


def _make_inexact_body(found: Finding, task: MatchingTask, sigma: float) -> Candidate:
    """The body with points that are off, in the poses that were found for it as given, and about predicted ones."""
    told, model = found.posterior_and_model
    task = copy_with(task, points=task.problem.with_source_noise(task.points, sigma))
    body = Candidate(task, perturb_points(model, sigma), empty_modes(task.rows))
    predicted = propose_predicted(body.model)
    if predicted is not None:
        body = copy_with(body, modes=find_modes(body.model, predicted, minimum=-HOPELESS))
    return body.add_modes(told.modes)


def _inexact_probability(found: Finding, again: Finding, before: Floats, which: int) -> float:
    """Probability of the body with points that are off, against other poses of it as given and something else.

    Either may have errors that are independent or smooth. ``before``: log-odds (OWN,) of errors of the body;
    ``which``: of them those of ``again``.
    """
    misfit = Misfit.of_finding(found)
    assert misfit is not None
    (told, model), (after, _) = found.posterior_and_model, again.posterior_and_model
    modes = told.modes
    elsewhere = ((modes.assignments >= 0) & (modes.assignments != again.assignment)).any(axis=1)
    errors = ERRORS * model.radius
    smooth = smooth_error_log_odds(model, after.modes, again.mode, errors)
    own = np.logaddexp.reduce([(again.log_odds or 0.0) + before[which], *(smooth[:OWN] + before)])
    other = found.log_odds or 0.0
    other += math.log(WRONG_MODEL * misfit.odds_of_something_else(len(model.images) > 1))
    against = np.logaddexp.reduce([*modes.log_mass[elsewhere].tolist(), other, *(smooth + LOG_ALIKE)])
    return probability(float(own - against))

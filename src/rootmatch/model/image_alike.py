"""What an image shows in the place of a body, if that is alike: each of its points stands near the body's own.

Another model of a controller, a body's mirror image, or a body that is bent has detections near the images of nearly
all points, and some of these within the noise. Against clutter those few are evidence for the body, whose other points
are hidden, and what is beside them is clutter by chance. So the alternative is the same body with points that are off,
each by N(0, τ² I), in the same pose but for what that changes: then every near miss is expected, and a match that is
exact costs log τ² / σ².
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.frozen import amend
from rootmatch.model.compiled.near_misses import fill_near_misses
from rootmatch.model.detection_model import DetectionModel, log_count_odds
from rootmatch.model.evidence import residual_statistics, settle_poses, settle_with_errors, weigh_assignments
from rootmatch.model.modes import Modes
from rootmatch.model.prediction import HIDDEN, Settled, look_about, settle_assignment
from rootmatch.model.priors import INEXACT, WRONG_MODEL

Told = TypeVar("Told")

ERRORS, OWN = np.array([3e-3, 1e-2, 3e-2, 1e-1]), 2
"""Standard deviations of a coordinate of points that are off, over the body's root mean square radius: those of what is
alike, each as probable as the others. So many of them are also those of a body that is not quite as its drawing. Round
values."""
LOG_INEXACT = math.log(INEXACT / OWN) - math.log1p(-INEXACT)
"""Log-odds that the body's points are off by each of these, of those that they are as given."""
LOG_ALIKE = math.log(WRONG_MODEL / len(ERRORS))
"""The same of something else of nearly the shape."""
LOG_PRIOR = np.repeat([LOG_INEXACT, LOG_ALIKE], [OWN, len(ERRORS) - OWN])
"""Those of all of them."""
REACH = 3.0
"""Deviation, in σ of an alike point, within which a detection may be its own. A round value."""
SEEN = math.log(9.0)
"""Odds of a point that is seen where it is visible, at most. A round value; it bounds time."""
MINIMUM = -3.0
"""Log-odds, against the body, that an alike one must be able to have to be looked for: it changes a probability by a
twentieth of what is allowed for. A round value; it bounds time."""


def alike_log_odds(model: DetectionModel, modes: Modes, k: int, taken: Bools | None = None) -> Floats | None:
    """Log-odds (W,) of a body with points that are off by each of `ERRORS`, in about the pose of one of the modes.

    ``k``: which mode; ``taken`` (n',): detections of other bodies.

    Returns
    -------
    (W,) float64 or None
        Over the body as given, with all changes of the mode; −∞ where they cannot matter. None where none can, as
        nothing is near a visible point that has no match, and what several cameras see of one fits.
    """
    assignment, images = modes.assignments[k], max(len(model.images), 1)
    missed = np.count_nonzero((assignment < 0) & (modes.visible[k] > HIDDEN)) > 0
    shared = images > 1 and bool(((assignment >= 0).reshape(images, -1).sum(axis=0) > 1).any())
    if not missed and not shared:
        return None
    errors = ERRORS * model.radius
    gains, free = _near_miss_gains(model, modes, k, errors, taken) if missed else (np.zeros((len(errors), 0)), 0)
    if not gains.any() and not shared:
        return None
    mode, freedom = modes.take(slice(k, k + 1)), float(modes.freedom[k])
    residuals = residual_statistics(model, assignment, modes.rotation[k], modes.position[k])
    before, out = float(mode.log_odds[0] - mode.log_mass[0]), np.full(len(errors), -np.inf)
    if gains.any():
        counts = log_count_odds((-(-free // images),), gains.shape[1])[0, 1:]
        maximum = before + residual_log_gains(model.noise_freedom, residuals, freedom, errors)
        maximum += (np.cumsum(np.sort(gains, axis=1)[:, ::-1], axis=1) + counts).max(axis=1)
        for one in (maximum + LOG_PRIOR >= MINIMUM).nonzero()[0].tolist():
            out[one] = cache_answer(_settle_alike, model, mode[:4], errors[one], taken) - mode.log_mass[0]
    if shared and residuals[0] > freedom:
        out = np.maximum(out, before + _sighting_log_gains(model, mode, errors))
    return out if (out + LOG_PRIOR >= MINIMUM).any() else None


def cache_answer(answer: Callable[..., Told], model: DetectionModel, *given: Any) -> Told:
    """What a function tells of a model and what is given, kept by the values of arrays: a search asks it again."""
    every = [part for one in given for part in (one if isinstance(one, tuple) else (one,))]
    key = answer, model.prior, *(one.tobytes() if isinstance(one, np.ndarray) else one for one in every)
    if key not in model.alike:
        model.alike[key] = answer(model, *given)
    return model.alike[key]  # type: ignore[no-any-return]


def residual_log_gains(given: float, residuals: tuple[float, float], freedom: float, errors: Floats) -> Floats:
    """Log-odds (W,) that points are off by errors (W,), by `residual_statistics` of matches alone, to first order.

    ``given``: residuals by which σ is known; ``freedom``: degrees of freedom of the squared deviation.
    """
    squared, moved = residuals
    ratio = 1.0 + errors**2 * moved
    less = np.log1p(squared / given) - np.log1p(squared / ratio / given)
    return np.asarray(0.5 * (given + freedom) * less - 0.5 * freedom * np.log(ratio))


def _sighting_log_gains(model: DetectionModel, mode: Modes, errors: Floats) -> Floats:
    """Log-odds (W,) that points are off by errors (W,), by their matches alone, over those of the mode.

    Cameras that see a point off see it off in one place, which larger noise would not do.
    """
    pose = mode.rotation, mode.position
    told = settle_with_errors(model, mode.assignments, pose, errors)
    if told is None:
        wide = [perturb_points(model, error) for error in errors.tolist()]
        told = np.array([settle_poses(one, mode.assignments, *pose)[0].log_odds[0] for one in wide])
    return np.asarray(told - mode.log_odds[0])


def perturb_points(model: DetectionModel, error: float, off: Bools | None = None) -> DetectionModel:
    """The model of a body whose points are off by N(0, error² I) as well; ``off`` (n,): which, all by default."""
    spread, known = np.zeros((len(model.points), 3, 3)), model.source_covariance
    spread[:, range(3), range(3)] = error**2 if off is None else error**2 * off[:, None]
    # a search asks this of mode after mode, and what is known of the image takes longer than all the rest
    wide = spread if known is None else known + spread
    return amend(model, "spread_for_kernels", "alike", source_covariance=wide)


def _exclude_detections(model: DetectionModel, taken: Bools) -> DetectionModel:
    """The model without the detections (n',) of other bodies."""
    allowed = np.tile(~taken, (model.shape[0], 1)) if model.allowed is None else model.allowed & ~taken
    of_pairs = "weights_of_pairs", "image_for_kernels", "gating_image", "scene_for_kernels"
    return amend(model, *of_pairs, "alike", allowed=allowed)


def _near_miss_gains(
    model: DetectionModel, modes: Modes, k: int, errors: Floats, taken: Bools | None
) -> tuple[Floats, int]:
    """About the most (W, m) that points without a match gain by one that is near if all are off by errors (W,).

    And the number of detections that they may have; no columns if nothing is near a visible point.
    """
    at = model.linearise_about(modes.rotation[k : k + 1], modes.position[k : k + 1])
    mode = np.array(modes.assignments[k]), np.array(modes.visible[k]), np.array(modes.covariance[k])
    left, gains = np.ones(model.shape[1], np.bool_) if taken is None else ~taken, np.empty((len(errors), len(mode[0])))
    target, sigma = model.image_for_kernels[:2]
    image = target, sigma, model.clutter.log_density, left
    points = at.pixels[0], at.jacobian[0], at.by_position[0]
    missed, free = fill_near_misses(points, mode, image, errors, (HIDDEN, REACH, SEEN), gains)
    return gains[:, :missed], free


def _settle_alike(model: DetectionModel, mode: tuple[Any, ...], error: float, taken: Bools | None) -> float:
    """Log-odds of the body with points that are off, with all that is near them."""
    others = taken is not None and taken.any()
    wide = perturb_points(cache_answer(_exclude_detections, model, taken) if others else model, error)
    known: dict[bytes, Settled] = {}
    assignments, rotation, position, (covariance,) = mode
    at = cache_answer(type(model).linearise_about, model, rotation, position)  # the same for all errors
    looked = look_about(wide, (rotation, position), covariance, at=at)
    settle_assignment(wide, (rotation, position), covariance, known=known, looked=looked)
    matched = weigh_assignments(wide, assignments, at)
    return max([float(matched.log_odds[0]), *(one.log_odds for one in known.values())])

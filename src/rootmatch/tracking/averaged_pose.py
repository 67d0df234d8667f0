"""Mean and covariance of a pose, over the changes of its assignment and along what its detections hardly determine.

A frame may leave open which of two points a detection is of. A filter that is told the pose of one of them predicts
that one, so that the next frame is certain of it: it gets the mean of both (joint probabilistic data association,
Fortmann, Bar-Shalom and Scheffe 1983).

A fit ends where the residuals are least; its covariance is that of a linear image, and knows nothing of which points
can be seen. Where few points are seen both are wrong by degrees in some directions, and a filter that is told so in
frame after frame drifts away, sure of it. There the posterior is evaluated at some poses on a line, and averaged.

Points that are seen face the camera. That others are not seen tells nothing here: what hides them hides them in the
next frame too, and taken as new in each frame it made a controller's rotation certain to 5 degrees where it was wrong
by 20 (benchmarks/flights.py, rig, seed 1105).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.rotation import (
    arc_motion,
    cross_matrix,
    move_along_arc,
    one_rotation_matrix,
    rotation_from_vector,
    rotation_vector,
)
from rootmatch.arrays import Floats
from rootmatch.model.compiled.averaging import average_weak_directions
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.errors_in_common import errors_in_common
from rootmatch.model.evidence import squared_deviations, weigh_assignments
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import PoseDensity, Terms
from rootmatch.model.priors import WRONG_MODEL, log_chance
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.shared_errors import SharedPose

WEAK = 0.02
"""Standard deviation in radians, or over the distance, from which a direction is averaged over. A round value."""
PLACES = np.linspace(-3.0, 3.0, 7)
"""Poses on the line, in standard deviations of the fit. A round value."""
MINIMUM = 0.25
"""Least variance along the line, over that of the fit: the poses on it are no closer. By construction."""


def average_pose(model: DetectionModel, modes: Modes, k: int) -> Pose:
    """The pose of one of some modes, averaged over its changes, then along its weak directions, one after another.

    Of the points as they were given, with its covariance, and with the errors that it has by those of the points.
    """
    R, position, covariance = _average_over_changes(modes, k)
    a, b, c, *of_place = covariance.diagonal().tolist()
    # no eigenvalue is larger than the sum of all
    if a + b + c + sum(of_place) / max(float(position @ position), 1e-300) >= WEAK**2:
        about = np.array(R[None], float), np.array(position[None], float), np.array(covariance, float)
        prior = model.prior.for_kernels
        if model.exact_scene_for_kernels is None or prior is None:
            R, position, covariance = _average(model, modes.assignments[k], about)
        else:
            row = np.array(modes.assignments[k][None], np.int64)
            average_weak_directions(row, WEAK, PLACES, model.exact_scene_for_kernels, prior, MINIMUM, about)
            R, position, covariance = about[0][0], about[1][0], about[2]
    pose = model.pose_of_origin(R, position, 0.5 * (covariance + covariance.T))
    shared = errors_in_common(model, modes.assignments[k], pose)
    return pose if shared is None else SharedPose.of(pose, shared)


def _average_over_changes(modes: Modes, k: int) -> tuple[Floats, Floats, Floats]:
    """Rotation, position and covariance of a mode over all changes of its assignment, the first two moments of all."""
    R, position, covariance = modes.rotation[k], modes.position[k], modes.covariance[k]
    _, values, steps = modes.near[k]
    weight = np.exp(np.minimum(values - modes.log_odds[k], 0.0))
    whole = 1.0 + float(weight.sum())
    if 1.0 - 1.0 / whole < WRONG_MODEL:
        return R, position, covariance
    weight /= whole
    mean = weight @ steps
    spread = (weight[:, None] * steps).T @ steps - np.outer(mean, mean)
    return one_rotation_matrix(mean[:3]) @ R, position + mean[3:], covariance + spread


def _average(
    model: DetectionModel, assignment: NDArray[np.int64], about: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats, Floats]:
    """Rotation (3, 3), position (3,) and covariance (6, 6) of an average, from those of a fit, (1, …) but the last."""
    (R,), (position,), covariance = about
    known, mean = _About.of(model.prior, R, position), np.zeros(6)
    lines = _weak_directions(covariance, max(math.sqrt(position @ position), 1e-300))
    model = replace(model, prior=known)
    for line in lines.T:
        moments = _project_along(model, assignment, known, mean + PLACES[:, None] * line, lines=lines)
        if moments is not None:
            mean, spread = moments
            covariance = covariance - np.outer(line, line) + spread + MINIMUM * np.outer(line, line)
    moved = move_along_arc(mean[:3], mean[3:])
    change = _refer_to(moved[None])[0]
    return one_rotation_matrix(mean[:3]) @ R, position + moved, change @ covariance @ change.T


@dataclass(frozen=True, eq=False)
class _About(PoseDensity):
    """What is known of a pose beside the detections, as it is about one pose, at others along arcs from there.

    What a frame leaves open is no more or less known on an arc than on its tangent: so is a rotation about a line of
    points. So it is about the fit that a prior is of second order, along motions of the body at constant rates.
    """

    rotation: Floats
    position: Floats
    precision: Floats
    slope: Floats

    @classmethod
    def of(cls, prior: PoseDensity, rotation: Floats, position: Floats) -> _About:
        """That of a prior about a pose (3, 3) and (3,)."""
        terms = prior.terms(rotation[None], position[None])
        return cls(rotation, position, terms.precision[0], terms.slope[0])

    def components(self, rotation: Floats, position: Floats) -> Terms:
        """See `PoseDensity.components`."""
        vectors, moved = rotation_vector(rotation @ self.rotation.T), position - self.position
        off, change = np.concatenate([vectors, arc_motion(vectors, moved)], axis=1), _refer_to(-moved)
        precision = change.swapaxes(1, 2) @ self.precision @ change
        slope = ((self.slope - off @ self.precision)[:, None] @ change)[:, 0]
        zero = np.zeros((len(off), 1))
        return Terms(precision[:, None], slope[:, None], zero, zero)


def _refer_to(arms: Floats) -> Floats:
    """Matrices (K, 6, 6) of motions of a point to those of another, (K, 3) from it."""
    out = np.tile(np.eye(6), (len(arms), 1, 1))
    out[:, 3:, :3] = -cross_matrix(arms)
    return out


def _weak_directions(covariance: Floats, distance: float) -> Floats:
    """Directions (6, w) in which a covariance is large, as long as its standard deviation there, the largest first."""
    unit = np.repeat([1.0, distance], 3)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    weak = (values >= WEAK**2).nonzero()[0][::-1]
    return np.asarray(np.sqrt(values[weak]) * unit[:, None] * vectors[:, weak])


def _project_along(
    model: DetectionModel, assignment: NDArray[np.int64], known: _About, off: Floats, *, lines: Floats
) -> tuple[Floats, Floats] | None:
    """Mean (6,) and covariance (6, 6) of motions from a pose, by the posterior at some places (K, 6) on a line.

    ``lines`` (6, w): all weak directions.
    """
    moved = move_along_arc(off[:, :3], off[:, 3:])
    rotation, places = rotation_from_vector(off[:, :3]) @ known.rotation, known.position + moved
    assignments = np.repeat(assignment[None], len(off), axis=0)
    found = weigh_assignments(model, assignments, model.linearise_about(rotation, places))
    # to the valley, but along none of its weak directions
    unit = np.repeat([1.0, known.position @ known.position], 3)
    duals = _refer_to(-moved).swapaxes(1, 2) @ (lines / unit[:, None])
    push = found.covariance @ duals
    along = np.linalg.solve(duals.swapaxes(1, 2) @ push, (found.step[:, None] @ duals).swapaxes(1, 2))
    across = found.step - (push @ along)[..., 0]
    rotation, places = rotation_from_vector(across[:, :3]) @ rotation, places + across[:, 3:]
    off = off + (_refer_to(-moved) @ across[..., None])[..., 0]
    at = model.linearise_about(rotation, places)
    value = -0.5 * squared_deviations(model, assignments, at) + off @ known.slope
    value -= 0.5 * ((off @ known.precision) * off).sum(axis=1)
    seen = model.visibility(at, np.zeros(len(off)))
    value += np.where(assignments >= 0, log_chance(seen), 0.0).sum(axis=1)
    value = np.where(np.isfinite(value), value, -np.inf)
    if not np.isfinite(value.max()):
        return None
    weight = np.exp(value - value.max())
    weight /= weight.sum()
    mean = weight @ off
    return mean, (weight[:, None] * (off - mean)).T @ (off - mean)

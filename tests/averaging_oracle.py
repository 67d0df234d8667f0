"""Poses averaged along their weak directions, step by step in NumPy: what the compiled average is held to."""

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
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import squared_deviations, weigh_assignments
from rootmatch.model.modes import Modes
from rootmatch.model.pose_density import PoseDensity, Terms
from rootmatch.model.priors import log_chance
from rootmatch.tracking.averaged_pose import MINIMUM, PLACES, WEAK, _average_over_changes


def average_by_numpy(model: DetectionModel, modes: Modes, k: int) -> tuple[Floats, Floats, Floats]:
    """Rotation (3, 3), position (3,) and covariance (6, 6) of one of some modes, averaged."""
    R, position, covariance = _average_over_changes(modes, k)
    return _average(model, modes.assignments[k], (R[None], position[None], covariance))


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

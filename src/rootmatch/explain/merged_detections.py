"""Detections that are probably two points of a body each, as the model itself finds, where none was said to be so.

A detector joins spots of light that are close to each other. In the pose that explains most, points whose images lie
within a few pixels are joined as `resolution=` would do it, for each distance there is, and the evidence of the pose is
worked out again with these blobs. How much it grows, over all of these distances, is what the image tells.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.explain.decide import MIN_PROBABILITY, Status
from rootmatch.explain.finding import Finding
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.prediction import settle_assignment
from rootmatch.model.visibility import BARELY

FURTHEST = 12.0
"""Distance in px within which detectors join spots. A round value."""
TRIED = 6
"""Distances that are tried, the smallest ones. A round value."""
JOINED = 1e-6
"""Relative step by which a resolution is above the distance of two points that it joins."""


class Merged(NamedTuple):
    """A resolution with which the image is more probable."""

    resolution: float
    """px, with two digits."""
    log_gain: float
    """Logarithm of how much more probable the image is than without, over all resolutions that were tried."""


def merged_advice(finding: Finding) -> str:
    """What to give where detections are probably two points each; nothing unless the model finds so."""
    found = find_merged(finding)
    if found is None or found.log_gain < math.log(MIN_PROBABILITY / (1.0 - MIN_PROBABILITY)):
        return ""
    return (
        f"; two points whose images are within {found.resolution:g} px of each other are probably one detection, at "
        f"their mean: give `resolution={found.resolution:g}`, or the distance within which your detector joins spots"
    )


def find_merged(finding: Finding) -> Merged | None:
    """The resolution with which what was found is most probable; None where no points are near each other."""
    told, model, task = finding.posterior, finding.model, finding.task
    if finding.status is Status.MATCHED or told is None or model is None or task.options.resolution is not None:
        return None
    modes = told.modes
    if not len(modes.log_mass) or not isinstance(model, DetectionModel):
        return None
    best = int(modes.log_mass.argmax())
    pose = modes.rotation[best : best + 1], modes.position[best : best + 1]
    distances = _near_distances(model, pose)
    if not len(distances):
        return None
    before = _log_odds(model, pose, modes.covariance[best])
    gains = np.array(
        [
            _log_odds(replace(model, resolution=(1.0 + JOINED) * one), pose, modes.covariance[best]) - before
            for one in distances.tolist()
        ]
    )
    if not np.isfinite(gains).any():
        return None
    mean = float(np.logaddexp.reduce(gains)) - math.log(len(gains))
    digits = 10.0 ** (math.floor(math.log10(distances[gains.argmax()])) - 1)
    return Merged(round(math.ceil(float(distances[gains.argmax()]) / digits) * digits, 6), mean)


def _near_distances(model: DetectionModel, pose: tuple[Floats, Floats]) -> Floats:
    """Distances in px, the smallest first, of the images of two points that a pose shows near each other."""
    at = model.linearise_about(*pose)
    shown = model.visibility(at, np.zeros(1))[0] > BARELY
    pixels = at.pixels[0][shown]
    first, second = np.triu_indices(len(pixels), 1)
    apart = np.linalg.norm(pixels[first] - pixels[second], axis=1)
    return np.asarray(np.sort(apart[(apart > 0.0) & (apart < FURTHEST)])[:TRIED])


def _log_odds(model: DetectionModel, pose: tuple[Floats, Floats], covariance: Floats) -> float:
    """Log-odds of what is assigned about a pose."""
    found = settle_assignment(model, pose, covariance, known={})
    return -math.inf if found is None else found.log_odds

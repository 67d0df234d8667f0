"""Cameras of a rig that show nothing of a body where its pose puts it, as one that was knocked, or that is late."""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Bools, Floats
from rootmatch.explain.decide import Status
from rootmatch.explain.finding import Finding
from rootmatch.model.detection_model import HIGHEST_RATE

BY_CHANCE = 1e-3
"""Probability that a camera has as few sightings of a body from which that is not told: a camera that was knocked, or
hidden, is far more frequent. A round value."""
FEW = 2
"""Sightings in a camera that clutter may make: a minimal set has one more."""
FAR = 100.0
"""Distance of a body, over that of the cameras from each other, from which all of these are as in one place: a rig is
not built so. A round value."""


def unit_advice(finding: Finding) -> str:
    """What to check where one camera of several shows the object: in a unit too small, all are as in one place."""
    task = finding.task
    one_camera = len({*task.camera_of[finding.assignment[finding.assignment >= 0]]}) == 1 and task.rig is not None
    return "; check that the points and the rig have the same unit, or see `diagnose`" if one_camera else ""


def scale_advice(finding: Finding) -> str:
    """What to check where a trusted body is so far away that it hardly matters where the cameras of a rig are."""
    rig, pose, told = finding.task.rig, finding.pose, unit_advice(finding)
    if rig is None or pose is None or not told or len(rig.cameras) < 2:
        return ""
    distance = float(np.linalg.norm(pose.transform(finding.task.points.source.mean(axis=0)[None])[0]))
    apart = float(np.linalg.norm(rig.centres - rig.centres[0], axis=1).max())
    if not 0.0 < apart * FAR < distance:
        return ""
    return (
        f"; only one camera shows it, and it is {distance / apart:.0f} times as far away as the cameras are apart{told}"
    )


def camera_advice(finding: Finding) -> str:
    """What is told of cameras that show nothing of a body, or of any of several; nothing if all show it."""
    parts = (finding,) if finding.parts is None else finding.parts.values()
    silent = sorted({k for part in parts for k in find_silent_cameras(part)})
    if not silent:
        return ""
    each, many = ", ".join(map(str, silent)), len(silent) > 1
    which = f"cameras {each} show" if many else f"camera {each} shows"
    return (
        f"; {which} next to nothing where the body should be seen: {'their' if many else 'its'} calibration or clock "
        "may be off, or something hides the body there; `diagnose` tests whether a camera was moved"
    )


def find_silent_cameras(finding: Finding) -> list[int]:
    """Cameras with detections, hardly any of a body that was found, where the model all but excludes that few.

    By their numbers; a camera without any detection may have had no image. What an image of unknown size shows reaches
    as far as its detections. Of several places that may be the body's, in the one that explains most.
    """
    told, model, rig = finding.posterior, finding.model, finding.task.rig
    if rig is None or finding.status is Status.UNTRUSTED or told is None or model is None:
        return []
    modes, which = told.modes, finding.mode
    if finding.status is not Status.MATCHED:
        which = int(modes.log_mass.argmax())
    own = slice(which, which + 1)
    at = model.linearise_about(modes.rotation[own], modes.position[own])
    visible = model.visibility(at, np.zeros(1))[0]
    if model.allowed is not None:
        visible = np.where(model.allowed.any(axis=1), visible, 0.0)
    seen = (modes.assignments[which] >= 0).reshape(len(model.images), -1)
    visible = visible.reshape(seen.shape)
    if rig.sizes is None:
        for k, pixels in enumerate(np.split(at.pixels[0], len(seen))):
            shown = model.target[model.images[k]]
            if len(shown):
                visible[k] *= ((pixels >= shown.min(axis=0)) & (pixels <= shown.max(axis=0))).all(axis=1)
    chance = chance_of_as_few(visible, seen, *model.rate_quadrature)
    return [k for k, images in enumerate(model.images) if len(images) and chance[k] < BY_CHANCE]


def chance_of_as_few(visible: Floats, seen: Bools, rates: Floats, log_weights: Floats) -> Floats:
    """Probability (C,) that each camera detects as few of the points, at the rate of those that show more than `FEW`.

    It is 1 of these. ``visible``, ``seen``: (C, n); ``rates``, ``log_weights``: (Q,) of the integral over the detection
    rate, see `DetectionModel.rate_quadrature`.
    """
    chance = np.minimum(rates[:, None, None] * visible, HIGHEST_RATE)
    count = seen.sum(axis=1)
    with np.errstate(divide="ignore"):  # what is seen where it is not visible
        each = np.where(seen, np.log(chance), np.log1p(-chance)).sum(axis=2)[:, count > FEW].sum(axis=1)
    if not np.isfinite(each).any():
        return np.ones(len(seen))
    weights = np.exp(log_weights + each - each.max())
    odds = chance / (1.0 - chance)
    one, squares = odds.sum(axis=2), (odds**2).sum(axis=2)
    sets = np.array([np.ones_like(one), one, 0.5 * (one**2 - squares)])  # of none, one and two points
    few = np.prod(1.0 - chance, axis=2) * sets.cumsum(axis=0)[np.minimum(count, FEW), :, np.arange(len(seen))].T
    return np.asarray(np.where(count > FEW, 1.0, weights @ few / weights.sum()))

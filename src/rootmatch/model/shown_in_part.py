"""A body that is in view, but of which the image shows too little to recognise it.

Fewer points than make a mode fit any image: under the prior of all poses each of them lies anywhere, so a sum over the
poses and the detections that they may have is, in the mean, that of clutter. What is left is how probable it is that
so few are detected, and that so many detections are clutter: with k of n points detected and n' detections,

    W = Σ_(k ≤ m) P(k | present) · n'! / (n' − k)! · Γ(n' − k + ½) / Γ(n' + ½),

the odds against clutter alone. P(k | present) is a mean over turns of the body, rates, and what is hidden as a whole.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.rotation import spread_rotations
from rootmatch.arrays import Floats, Integers
from rootmatch.model.compiled.occluder import OCCLUDED
from rootmatch.model.detection_model import HIGHEST_RATE, DetectionModel
from rootmatch.model.priors import PRESENT_ODDS
from rootmatch.model.views import frames_of

TURNS = 64
"""Turns of a body with normals over which a mean is taken. A round value."""
IN_SIGHT = (1.0 / 6.0, 0.5, 5.0 / 6.0)
"""Parts of a body that an edge or a window leaves in sight, equally probable: any point may be the first it hides."""
RADII = 10.0
"""Distance of a body in its radii at which its normals are looked at. A round value between 1 and 100."""


def undetected(model: DetectionModel, most: int, counts: Integers) -> Floats:
    """Probability (n,) that each point has no detection, if the image shows no mode: the body is absent, or shows few.

    Parameters
    ----------
    model : DetectionModel
    most : int
        Detected points, in each image of a rig, that make no mode.
    counts : (C,) int array
        Detections that each image has for the body.
    """
    odds, few = shown_in_part(model, most, counts)
    odds *= math.exp(PRESENT_ODDS)
    return (1.0 + odds * few) / (1.0 + odds)


def shown_in_part(model: DetectionModel, most: int, counts: Integers) -> tuple[float, Floats]:
    """Odds that an image shows the body with at most so few points, against clutter alone.

    Parameters
    ----------
    model : DetectionModel
    most : int
        Detected points, in each image of a rig, that make no mode.
    counts : (C,) int array
        Detections that each image has for it.

    Returns
    -------
    float
        W, prior odds of the body's presence apart.
    (n,) float array
        Probability that each point is not detected, if that is so.
    """
    images, n = len(counts), len(model.points)
    rates, log_weights = model.rates
    sight = np.array([1.0, *IN_SIGHT])
    shares = np.array([1.0 - OCCLUDED, *[OCCLUDED / len(IN_SIGHT)] * len(IN_SIGHT)])
    visible = _visible(model)
    some = 1.0 - np.prod(1.0 - visible, axis=1)  # what shows no point is not in view
    chance = np.outer(sight, rates).reshape(-1, 1) * visible[:, None]
    weights = np.outer(shares, np.exp(log_weights)).reshape(-1)
    chance = np.minimum(chance, HIGHEST_RATE).reshape(len(chance), len(weights), images, n // images)
    odds = chance / (1.0 - chance)
    sums = np.zeros((most + 1, *odds.shape[:3]))  # over the sets of 0, 1, … points: products of their odds
    sums[0] = 1.0
    for point in range(n // images):
        sums[1:] += odds[..., point] * sums[:-1]
    ways = _ways(counts, most)
    whole = (ways[:, None, None] * sums).sum(axis=0)
    each = (some / some.sum())[:, None] * weights * np.exp(np.log1p(-chance).sum(axis=(-2, -1)) + np.log(whole).sum(axis=-1))
    others, with_it = np.ones_like(odds), np.zeros_like(odds)
    for k in range(1, most + 1):
        with_it += ways[k, :, None] * odds * others
        others = sums[k, ..., None] - odds * others  # sets of k points without this one
    detected = np.einsum("sq,sqcp->cp", each, with_it / whole[..., None]).reshape(-1)
    total = max(float(each.sum()), 1e-300)
    return total, np.clip(1.0 - detected / total, 0.0, 1.0)


def _ways(counts: Integers, most: int) -> Floats:
    """Ways (most + 1, C) to own 0, 1, … of the detections, times the odds that all the others are clutter."""
    ways = np.ones((most + 1, len(counts)))
    for k in range(1, most + 1):
        left = np.maximum(counts - k + 1, 0)
        ways[k] = ways[k - 1] * left / (np.maximum(left, 1) - 0.5)
    return ways


def _visible(model: DetectionModel) -> Floats:
    """Visibility (S, n) of the points in poses anywhere: of all turns alike, before each camera."""
    rotations, translations = frames_of(model.camera)
    if model.normals is None and len(rotations) == 1:
        return np.ones((1, len(model.points)))
    radius = math.sqrt(float((model.about_centre[0] ** 2).sum(axis=1).mean()))
    which = np.arange(TURNS) % len(rotations)
    ahead = np.array([0.0, 0.0, RADII * radius]) - translations[which]
    at = model.linearised(spread_rotations(TURNS), (ahead[:, None] @ rotations[which])[:, 0])
    return model.visibility(at, np.zeros(TURNS))

"""Labellings of two views of a scene that repeats itself, displaced along it.

The search ends with the poses that explain most, and of a row that is where a camera moves least from one place to the
next: the right labelling may be a period away from all that it found. As matches tell where points are, so do they
which displacements in space put many points into the directions of others, and each of those is another labelling.
"""

from __future__ import annotations

import numpy as np

from rootmatch.arrays import Integers
from rootmatch.model.two_view_fit import fit_relative_poses
from rootmatch.model.two_view_model import Relative, TwoViewModel
from rootmatch.model.two_view_posterior import likeliest_labellings
from rootmatch.model.two_view_samples import likeliest_fits
from rootmatch.samplers.two_views.relative_hypothesis import OTHER, shared_match_share

DISPLACED = 3
"""Most displaced labellings, those of most points first: a step each way, and one more. A round value."""
TRIED = 256
"""Most displacements that are tried, those that are known best of all between two points. A round value."""
RATIOS = 1_000_000
"""Displacements times pairs of points: 8 MB an array."""
NEAR2 = 9.0
"""Squared deviation, in σ, up to which a displaced point may be another one. A round value."""


def displaced_labellings(model: TwoViewModel, pose: Relative, assignment: Integers) -> Integers:
    """Labellings (K, n) in which points have the matches of those to which a displacement moves them.

    ``assignment`` (n,): the matches of the one pose.
    """
    own = np.flatnonzero(assignment >= 0)
    none = np.zeros((0, len(assignment)), np.int64)
    if len(own) < model.size:
        return none
    to = _displacement_maps(model, pose, own, assignment[own])
    every = np.full((len(to), len(assignment)), -1, np.int64)
    every[:, own] = np.where(to >= 0, assignment[own[to]], -1)
    kept = none
    for one in every[np.argsort(-(to >= 0).sum(axis=1), kind="stable")]:
        if len(kept) == DISPLACED or (one >= 0).sum() < model.size:
            break
        if not (shared_match_share(np.concatenate([assignment[None], kept]), one) > OTHER).any():
            kept = np.concatenate([kept, one[None]])
    if not len(kept):
        return kept
    fits = fit_relative_poses(model, kept)
    return likeliest_labellings(model, fits.take(likeliest_fits(model, fits, len(kept))))


def _displacement_maps(model: TwoViewModel, pose: Relative, own: Integers, taken: Integers) -> Integers:
    """Which of K points each is moved to by displacements, (D, K), from −1 for none, and those that are no other's."""
    seen, count = model.seen(pose, own, taken), len(own)
    bearings, variance = model.first[own], model.first_variance[own]
    with np.errstate(all="ignore"):
        noise = np.sqrt(seen.floor2[0])
        inverse = np.maximum(seen.parallax[0] / seen.ahead[0], noise)
    places, across = bearings / inverse[:, None], (noise / inverse**2) ** 2
    i, j = np.nonzero(~np.eye(count, dtype=np.bool_))
    steps, variances = places[j] - places[i], across[i] + across[j]
    known = np.argsort(variances / np.maximum((steps**2).sum(axis=1), 1e-300), kind="stable")
    known = known[: min(TRIED, max(RATIOS // count**2, 1))]
    steps, variances = steps[known, None], variances[known, None]
    moved = bearings + steps * inverse[:, None]
    size2 = (moved**2).sum(axis=2)
    moved /= np.sqrt(size2)[:, :, None]
    # a point that is not where it is thought to be along its line goes elsewhere, as far as the step is across that
    sideways2 = (steps**2).sum(axis=2) - (moved * steps).sum(axis=2) ** 2
    own_variance = variance + (sideways2 * noise**2 + variances * inverse**2) / size2
    ratio = (2.0 - 2.0 * moved @ bearings.T) / (own_variance[:, :, None] + variance)
    ratio[:, np.arange(count), np.arange(count)] = np.inf
    to, back = ratio.argmin(axis=2), ratio.argmin(axis=1)
    near = np.take_along_axis(ratio, to[:, :, None], axis=2)[:, :, 0] < NEAR2
    return np.where(near & (np.take_along_axis(back, to, axis=1) == np.arange(count)), to, -1)

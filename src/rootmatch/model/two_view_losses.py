"""How probable it is that labellings of two views lose the points that they lose, where the scene looks like itself.

Of a labelling and the same one a period away, either may be right, whatever fits better. But what is lost tells them
apart: a point that leaves the view lacks nothing, while of those in view each is detected by chance. A labelling that
lacks the last column of a wall costs nothing, and one that lacks points amid others, or meets new ones there, does.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.algebra.directions import tangent_bases
from rootmatch.algebra.rotation import cross
from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.model.two_view_fit import masked_median
from rootmatch.model.two_view_model import Relative, TwoViewModel
from rootmatch.model.two_view_posterior import likeliest_labellings
from rootmatch.model.two_view_samples import fit_likeliest
from rootmatch.problems.points import mutual_nearest
from rootmatch.samplers.two_views.relative_hypothesis import OTHER, shared_match_share

DIRECTIONS = 64
"""Directions in which a border of an image may lie. A round value."""
RIM = 0.03
"""How far beyond all that is detected a point is out of view, in root mean squares of their distances from the middle:
as much as its predicted place may be wrong. A round value."""
DEGENERATE = 0.01
"""Least singular value, over the largest one, at which points tell how the plane lies in which they are. Round."""
ROUNDS = 4
"""Rounds of a fit in which what is off the plane counts less. A round value."""

DISPLACED = 3
"""Most displaced labellings, those of most points first: a step each way, and one more. A round value."""
TRIED = 256
"""Most displacements that are tried, those that are known best of all between two points. A round value."""
RATIOS = 1_000_000
"""Displacements times pairs of points: 8 MB an array."""
NEAR2 = 9.0
"""Squared deviation, in σ, up to which a displaced point may be another one. A round value."""


def log_loss_probability(model: TwoViewModel, assignments: Integers) -> Floats:
    """Logarithm (K,) of the probability that just the matches of assignments (K, n) are seen, of what is in both views.

    In each image the share of those that are detected in the other one is anything. Points are predicted as if they
    lay in a plane.
    """
    from scipy.special import betaln  # slow to import

    poses = fit_likeliest(model, assignments).poses
    used, taken = assignments >= 0, np.zeros((len(assignments), model.shape[1] + 1), np.bool_)
    np.put_along_axis(taken, assignments, True, axis=1)  # the last one by points without a match
    plane = poses.rotation + poses.translation[:, :, None] * _inverse_distances(model, poses, assignments)[:, None]
    there = _is_in_view(model.first @ plane.swapaxes(1, 2), model.second) & ~used
    back = _is_in_view(model.second @ np.linalg.pinv(plane).swapaxes(1, 2), model.first) & ~taken[:, :-1]
    # with a uniform share of those detected, each number of them is as probable
    matched = 1.0 + used.sum(axis=1)
    return np.asarray(sum(betaln(matched, 1.0 + lost.sum(axis=1)) for lost in (there, back)))


def _inverse_distances(model: TwoViewModel, poses: Relative, assignments: Integers) -> Floats:
    """Vectors (K, 3) whose products with bearings are the inverse distances b / λ of planes, as matches tell them."""
    used, second = assignments >= 0, model.second[assignments]
    # λ' p = λ R q + b t, without λ' once it is crossed with p
    across = cross(second, poses.translation[:, None])
    turned = cross(second, model.first @ poses.rotation.swapaxes(1, 2))
    inverse = -(turned * across).sum(axis=2) / np.maximum((across**2).sum(axis=2), 1e-300)
    weight, products = used.astype(np.float64), model.first[:, :, None] * model.first[:, None]
    for _ in range(ROUNDS):
        normal = np.tensordot(weight, products, 1)
        side = (weight * inverse) @ model.first
        g = (np.linalg.pinv(normal, rcond=DEGENERATE**2, hermitian=True) @ side[:, :, None])[:, :, 0]
        off = np.abs(g @ model.first.T - inverse)
        weight = used / (1.0 + (off / np.maximum(2.0 * masked_median(off, used), 1e-12)[:, None]) ** 2)
    return np.asarray(g)


def _is_in_view(predicted: Floats, seen: Floats) -> Bools:
    """Which of some predicted directions (K, m, 3) lie amid the bearings (n, 3) of an image."""
    middle = seen.mean(axis=0)
    across = np.concatenate(tangent_bases(middle[None] / np.linalg.norm(middle)))
    angle = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    sides = across.T @ np.stack([np.cos(angle), np.sin(angle)])
    along = seen @ sides / (seen @ middle)[:, None]
    border = along.max(axis=0) + RIM * math.sqrt(2.0 * float((along**2).mean()))
    ahead = predicted @ middle
    amid = (predicted @ sides <= border * ahead[:, :, None]).all(axis=2)
    return np.asarray(amid & (ahead > 0.0))


def displaced_labellings(model: TwoViewModel, pose: Relative, assignment: Integers) -> Integers:
    """Labellings (K, n) in which points have the matches of those to which a displacement moves them.

    The search ends with the poses that explain most, and of a row that is where a camera moves least from one place to
    the next: the right labelling may be a period away from all that it found. As matches tell where points are, so do
    they which displacements in space put many points into the directions of others, and each is another labelling.
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
    return likeliest_labellings(model, fit_likeliest(model, kept)) if len(kept) else kept


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
    return mutual_nearest(ratio, NEAR2)

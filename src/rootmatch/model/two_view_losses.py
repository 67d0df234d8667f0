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
from rootmatch.model.two_view_fit import fit_relative_poses, masked_median
from rootmatch.model.two_view_model import Relative, TwoViewModel
from rootmatch.model.two_view_samples import likeliest_fits

DIRECTIONS = 64
"""Directions in which a border of an image may lie. A round value."""
RIM = 0.03
"""How far beyond all that is detected a point is out of view, in root mean squares of their distances from the middle:
as much as its predicted place may be wrong. A round value."""
DEGENERATE = 0.01
"""Least singular value, over the largest one, at which points tell how the plane lies in which they are. Round."""
ROUNDS = 4
"""Rounds of a fit in which what is off the plane counts less. A round value."""


def log_loss_probability(model: TwoViewModel, assignments: Integers) -> Floats:
    """Logarithm (K,) of the probability that just the matches of assignments (K, n) are seen, of what is in both views.

    In each image the share of those that are detected in the other one is anything. Points are predicted as if they
    lay in a plane.
    """
    from scipy.special import betaln  # slow to import

    fits = fit_relative_poses(model, assignments)
    poses = fits.poses.take(likeliest_fits(model, fits, len(assignments)))
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

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
from rootmatch.arrays import Floats, Integers
from rootmatch.model.two_view_fit import fitted
from rootmatch.model.two_view_model import TwoViewModel

DIRECTIONS = 64
"""Directions in which a border of an image may lie. A round value."""
RIM = 0.03
"""How far beyond all that is detected a point is out of view, in root mean squares of their distances from the middle:
as much as its predicted place may be wrong. A round value."""
DEGENERATE = 0.01
"""Least singular value, over the largest one, at which points tell how the plane lies in which they are. Round."""
ROUNDS = 4
"""Rounds of a fit in which what is off the plane counts less. A round value."""


def log_chance_of_losses(model: TwoViewModel, assignments: Integers) -> Floats:
    """Logarithm (K,) of the probability that just the matches of assignments (K, n) are seen, of what is in both views.

    In each image the share of those that are detected in the other one is anything. Points are predicted as if they
    lay in a plane.
    """
    fits = fitted(model, assignments)
    starts = len(fits.chi2) // len(assignments)
    best = fits.chi2.reshape(-1, starts).argmin(axis=1) + starts * np.arange(len(assignments))
    poses = fits.poses.take(best)
    logs = []
    for assignment, R, t in zip(assignments, poses.rotation, poses.translation, strict=True):
        own, left = np.flatnonzero(assignment >= 0), np.ones(model.shape[1], np.bool_)
        left[assignment[own]] = False
        first, second = model.first[own], model.second[assignment[own]]
        plane = R + t[:, None] * _inverse_distances(first, second, R, t)
        lost = (
            _in_view(model.first[assignment < 0] @ plane.T, model.second),
            _in_view(model.second[left] @ np.linalg.pinv(plane).T, model.first),
        )
        # with a uniform share, each number of them is as probable
        logs.append(-sum(math.log((len(own) + k + 1.0) * math.comb(len(own) + k, k)) for k in lost))
    return np.array(logs)


def _inverse_distances(first: Floats, second: Floats, R: Floats, t: Floats) -> Floats:
    """Vector (3,) whose products with bearings are the inverse distances b / λ of a plane, as matches (m, 3) tell."""
    # λ' p = λ R q + b t, without λ' once it is crossed with p
    across = cross(second, t)
    inverse = -(cross(second, first @ R.T) * across).sum(axis=1) / np.maximum((across**2).sum(axis=1), 1e-300)
    weight = np.ones(len(first))
    for _ in range(ROUNDS):
        g = np.linalg.lstsq(weight[:, None] * first, weight * inverse, rcond=DEGENERATE)[0]
        off = np.abs(first @ g - inverse)
        weight = 1.0 / np.sqrt(1.0 + (off / max(2.0 * float(np.median(off)), 1e-12)) ** 2)
    return np.asarray(g)


def _in_view(predicted: Floats, seen: Floats) -> int:
    """How many of some predicted directions (k, 3) lie amid the bearings (n, 3) of an image."""
    middle = seen.mean(axis=0)
    ahead, far = predicted @ middle, seen @ middle
    across = np.concatenate(tangent_bases(middle[None] / np.linalg.norm(middle)))
    angle = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
    sides = across.T @ np.stack([np.cos(angle), np.sin(angle)])
    along = seen @ sides / far[:, None]
    size = math.sqrt(2.0 * float((along**2).mean()))
    inside = predicted @ sides / np.maximum(ahead, 1e-9)[:, None] <= along.max(axis=0) + RIM * size
    return int((inside.all(axis=1) & (ahead > 0.0)).sum())

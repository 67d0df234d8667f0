"""Near symmetries of a body one after another: from where the rows of a lattice may be counted.

An image shows ten lamps of a ceiling. The near symmetries that map most of the body are few steps along it, and put
some of these ten where no lamp is; many steps away all ten may have lamps again. None of the poses between is probable,
so twins of twins do not lead there, and a search meets such a pose by chance alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats, Integers, cache_by_identity, cache_by_values
from rootmatch.deadline import checkpoint
from rootmatch.model.near_symmetries import LAW, find_symmetries, same_point_tolerance
from rootmatch.model.pose_density import Doubted, Gaussian
from rootmatch.model.prediction import GATE
from rootmatch.model.proposals import Proposals, empty_proposals, join_proposals
from rootmatch.problems.points import PointSets

MAX_MOTIONS = 1024
"""Motions from which no more are sought. A round value; it bounds time, to .2 s for a body."""
MAXIMUM = 24
"""Motions that are proposed for a pose, those that keep most of its matches. A round value, as for few points."""
SPOT = 4.0
"""Distance, over that up to which points are the same, within which the images of a body are of one motion mostly; what
is taken for two is compared point by point. A round value."""


class Succession(NamedTuple):
    """M motions x' = R x + t that put points of a body onto others."""

    rotation: Floats
    """(M, 3, 3)."""
    shift: Floats
    """(M, 3)."""
    image: Integers
    """(M, n) point at the place of each after the motion; −1 for none."""


@cache_by_values(64)
def compose_symmetries(source: Floats, normals: Floats | None) -> Succession:
    """What near symmetries of a body (n, 3), and their inverses, are one after another, without these themselves.

    Those of the fewest steps first, which put `LAW` points onto others at least.
    """
    found, n, near = find_symmetries(source, normals), len(source), same_point_tolerance(source)
    rotation, shift = np.array([np.eye(3), *(one.rotation for one in found)]), np.zeros((1 + len(found), 3))
    image = np.array([np.arange(n), *(one.image for one in found)])
    if not found:
        return Succession(rotation[1:], shift[1:], image[1:])
    from scipy.spatial import cKDTree  # slow to import

    shift[1:] = [one.shift for one in found]
    back = rotation[1:].swapaxes(1, 2)
    steps = np.concatenate([rotation[1:], back]), np.concatenate([shift[1:], -(back @ shift[1:, :, None])[..., 0]])
    tree, spots, known, last = cKDTree(source), set[bytes](), {one.tobytes() for one in image}, 0
    while last < len(image) < MAX_MOTIONS:
        checkpoint()
        turned = (steps[0][:, None] @ rotation[last:]).reshape(-1, 3, 3)
        moved = ((steps[0][:, None] @ shift[last:, :, None])[..., 0] + steps[1][:, None]).reshape(-1, 3)
        some = np.rint((source[[0, n // 2, -1]] @ turned.swapaxes(1, 2) + moved[:, None]) / (SPOT * near)).astype(int)
        new = {one.tobytes(): k for k, one in reversed(list(enumerate(some)))}
        first = sorted(k for spot, k in new.items() if spot not in spots)
        spots.update(new)
        turned, moved, last = turned[first], moved[first], len(image)
        off, to = tree.query(source @ turned.swapaxes(1, 2) + moved[:, None], distance_upper_bound=near)
        to = np.where(off < near, to, -1)
        images = {to[k].tobytes(): k for k in np.flatnonzero((to >= 0).sum(axis=1) >= LAW).tolist()}
        kept = sorted(k for one, k in images.items() if one not in known)
        known.update(images)
        rotation, shift = np.concatenate([rotation, turned[kept]]), np.concatenate([shift, moved[kept]])
        image = np.concatenate([image, to[kept]])
    every = slice(1 + len(found), None)
    return Succession(rotation[every], shift[every], image[every])


@cache_by_identity(64)
@cache_by_values(64)
def list_displacements(
    source: Floats, normals: Floats | None, covariance: Floats | None
) -> tuple[Succession, Floats, Floats] | None:
    """All these motions of a body (n, 3), the near symmetries first; None if it has none, as most bodies.

    With their angles (M,) in radians, and the distances (M,) by which the middle of the body is moved.
    """
    found, further = find_symmetries(source, normals, covariance=covariance), compose_symmetries(source, normals)
    if not found:
        return None
    own = (np.array([getattr(one, name) for one in found]) for name in Succession._fields)
    motions = Succession(*map(np.concatenate, zip(own, further, strict=True)))
    middle, cosine = source.mean(axis=0), 0.5 * (np.einsum("mii->m", motions.rotation) - 1.0)
    away = np.linalg.norm(motions.rotation @ middle + motions.shift - middle, axis=1)
    return motions, np.arccos(np.clip(cosine, -1.0, 1.0)), away


def displacements_within(prior: Doubted, points: PointSets) -> Succession | None:
    """Those of all these motions of a body whose begin and end may both be about a predicted pose; None mostly.

    Each is within `GATE` standard deviations then. A tracker's prediction mostly excludes all of them.
    """
    every = list_displacements(points.source, points.normals, points.source_covariance)
    if every is None:
        return None
    spread = [one.bounded_covariance.diagonal() for one in prior.predictions if isinstance(one, Gaussian)]
    if not spread:
        return None
    turn, shift = (2.0 * GATE * math.sqrt(max(one[k] + one[k + 1] + one[k + 2] for one in spread)) for k in (0, 3))
    motions, angle, away = every
    (within,) = ((angle < turn) & (away < shift)).nonzero()
    return Succession._make(one[within] for one in motions) if len(within) else None


def propose_moved(
    found: Proposals, motions: Succession, image: Integers, centre: Floats, *, prior: Doubted | None = None
) -> Proposals:
    """Poses in which other points of a body lie where most of those do that are matched.

    Parameters
    ----------
    found : Proposals
        Of the body.
    motions : Succession
        Of the body.
    image : (M, r) array
        Row of an assignment at the place of each after the motions.
    centre : (3,) array
        Of its points.
    prior : Doubted, optional
        Only poses in which one of its predictions holds.
    """
    parts = [empty_proposals(found.assignments.shape[1])]
    for assignment, rotation, position in zip(*found, strict=True):
        (own,) = np.nonzero(assignment >= 0)
        mapped = (image[:, own] >= 0).sum(axis=1)
        turned = rotation @ motions.rotation.swapaxes(1, 2)
        place = position - rotation @ centre - (turned @ (motions.shift - centre)[..., None])[..., 0]
        if prior is not None and len(place):
            mapped[prior.prediction_indices(turned, place) < 0] = 0
        which = np.argsort(-mapped, kind="stable")[:MAXIMUM]
        which = which[2 * mapped[which] > len(own)]
        moved = np.full((len(which), len(assignment) + 1), -1)
        np.put_along_axis(moved, image[which][:, own], assignment[own], axis=1)  # −1 is the last place
        parts.append(Proposals(moved[:, :-1].copy(), turned[which], place[which]))
    return join_proposals(parts)

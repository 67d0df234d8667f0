"""Poses that are proposed because nothing in the image excludes them: other minima of few matches, and look-alikes.

From afar, what is nearly flat fits its image in two poses (Schweighofer & Pinz 2006), which meet where it faces the
camera. A search need not meet both, and neither is a change of the other's assignment.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers, cache_by_identity, cache_by_values
from rootmatch.model.compiled.few_poses import fill_minimal_poses
from rootmatch.model.compiled.reversal import reverse_depth
from rootmatch.model.compiled.steps import take_steps
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import STEEP, Evidence, settle_poses, weigh_poses
from rootmatch.model.linearised import Linearised
from rootmatch.model.pose_density import MINIMUM
from rootmatch.model.views import camera_frames

FEW = 6
"""Number of points up to which all poses of minimal sets are tried: with more, one minimum is far deeper than the
others, whichever cameras see them. A round value."""
FLAT = 0.05
"""Misfit of a motion, over the size of what it moves, up to which it is proposed beside a reflection that fits better.
A round value."""


class Proposals(NamedTuple):
    """K assignments with a pose each."""

    assignments: Integers
    """(K, n)."""
    rotation: Floats
    """(K, 3, 3)."""
    position: Floats
    """(K, 3) of the body's centre in the camera frame."""

    def take(self, which: Integers | Bools | slice) -> Proposals:
        """A subset of the proposals."""
        return Proposals(self.assignments[which], self.rotation[which], self.position[which])


@lru_cache(maxsize=64)
def empty_proposals(n: int) -> Proposals:
    """No proposals of a body of n points."""
    return Proposals(np.empty((0, n), np.int64), np.empty((0, 3, 3)), np.empty((0, 3)))


def join_proposals(parts: list[Proposals]) -> Proposals:
    """All of several proposals."""
    if len(parts) == 1:
        return parts[0]
    return Proposals._make(map(np.concatenate, zip(*parts, strict=True)))


def propose_few_matched(model: DetectionModel, assignments: Integers) -> Proposals:
    """Every pose of two minimal sets of each assignment (K, n) of up to `FEW` points, at least three in a camera.

    Four points in an image may have two poses, three have up to four, and each fits; one fit ends in one of them. A
    pose that fits in several cameras is one of those that fit in the one with the most matches; if two cameras or more
    see three of the points, these have one place in space, and the body one pose.
    """
    seen = (assignments >= 0).reshape(len(assignments), max(len(model.images), 1), -1)
    each = seen.sum(axis=2)
    few = (each.max(axis=1) >= MINIMUM) & (seen.any(axis=1).sum(axis=1) <= FEW)
    if seen.shape[1] > 1:
        few &= (seen.sum(axis=1) > 1).sum(axis=1) < MINIMUM
    if not few.any():
        return empty_proposals(assignments.shape[1])  # rays of a lens take longer than all the rest
    some = assignments[few]
    if seen.shape[1] == 1:
        return solve_minimal_sets(model, some, FEW).proposals
    camera, n = each[few].argmax(axis=1)[:, None], seen.shape[2]
    sets = solve_minimal_sets(model, np.where(np.arange(assignments.shape[1]) // n == camera, some, -1), FEW)
    return sets.proposals._replace(assignments=some[sets.of])


class MinimalSets(NamedTuple):
    """M poses of minimal sets of some assignments."""

    of: Integers
    """(M,) number of the assignment."""
    members: Integers
    """(M, 3) points of the minimal set."""
    proposals: Proposals
    """The assignments with these poses."""

    @property
    def alone(self) -> Proposals:
        """The minimal sets' own matches with their poses."""
        every, sets = self.proposals.assignments, np.arange(len(self.members))[:, None]
        own = np.full(every.shape, -1)
        own[sets, self.members] = every[sets, self.members]
        return self.proposals._replace(assignments=own)


def solve_minimal_sets(model: DetectionModel, assignments: Integers, maximum: int) -> MinimalSets:
    """As `propose_few_matched`, of up to so many matches in a camera."""
    assignments = np.array(assignments, np.int64)
    rotations, translations = camera_frames(model.camera)
    room = 8 * len(assignments) * len(rotations)
    of, members = np.empty(room, np.int64), np.empty((room, 3), np.int64)
    rotation, position = np.empty((room, 3, 3)), np.empty((room, 3))
    count = fill_minimal_poses(
        model.centred_body[0],
        (model.image_for_kernels[0], model.rays),
        assignments,
        (rotations, translations),
        maximum,
        (of, members, rotation, position),
    )
    proposals = Proposals(assignments[of[:count]], rotation[:count], position[:count])
    return MinimalSets(of[:count], members[:count], proposals)


def fit_assignments(model: DetectionModel, assignments: Integers) -> tuple[Proposals, Evidence, Linearised]:
    """Assignments (K, n) at the best poses that lead on from their minimal sets; those without one in a camera are not.

    Returns
    -------
    Proposals
        With fitted poses.
    Evidence, Linearised
        Of those assignments about these poses.
    """
    return refit_proposals(model, rough_fits(model, assignments))


def rough_fits(model: DetectionModel, assignments: Integers) -> Proposals:
    """As `fit_assignments`, one step away from a minimal set."""
    sets = solve_minimal_sets(model, assignments, assignments.shape[1])
    found, at = weigh_poses(model, *sets.proposals)
    order = np.lexsort((-found.log_odds, sets.of))
    best = order[np.unique(sets.of[order], return_index=True)[1]]
    poses = np.empty((len(best), 3, 3)), np.empty((len(best), 3))
    take_steps(found.step[best], at.rotation[best], at.position[best], STEEP, poses)
    return Proposals(sets.proposals.assignments[best], *poses)


def refit_proposals(model: DetectionModel, proposals: Proposals) -> tuple[Proposals, Evidence, Linearised]:
    """Assignments at the best poses near their own; see `fit_assignments`."""
    found, at = settle_poses(model, *proposals)
    return Proposals(proposals.assignments, at.rotation, at.position), found, at


def reverse_depths(model: DetectionModel, proposals: Proposals) -> Proposals:
    """The other poses that nearly flat points have from afar, with the same matches, for the camera that has most."""
    assignments = np.array(proposals.assignments, np.int64)
    poses = np.array(proposals.rotation, order="C"), np.array(proposals.position, order="C")
    out = np.empty(poses[0].shape), np.empty(poses[1].shape)
    reverse_depth(assignments, model.centred_body[0], poses, camera_frames(model.camera), out)
    return Proposals(proposals.assignments, *out)


def look_alikes(proposals: Proposals, first: Floats, second: Floats, images: Integers) -> Proposals:
    """Poses in which a second body looks like a first one, of which it is a copy, the mirror image, or the body itself.

    A copy of a body looks the same in the corresponding pose. The mirror image of a body with reversed depth has the
    same image except for perspective. Only normals and the fit to the detections can tell such poses apart.

    Parameters
    ----------
    proposals : Proposals
        Of the first body.
    first, second : (n, 3) and (m, 3) arrays
        Points of the two bodies.
    images : (T, n) int array
        For each way in which they look alike, the point of the second that corresponds to each of the first, −1 for
        none; at least three, and the same points of the first in each.

    Returns
    -------
    Proposals
        T for each one given, way by way; for a way that is a reflection and nearly a motion, as of flat bodies,
        one of each.
    """
    own, ways, motions, mirrored, middle, middles = _align_ways(first, second, images)
    rotation = proposals.rotation @ motions[:, None]
    # the centroids of the corresponding points coincide in both bodies
    place = proposals.position + middle @ proposals.rotation.swapaxes(1, 2)
    if len(mirrored):
        along = place / np.sqrt((place * place).sum(axis=1))[:, None]
        rotation[mirrored] = (np.eye(3) - 2.0 * along[:, :, None] * along[:, None]) @ rotation[mirrored]
    offset = (rotation @ middles[:, None, :, None])[..., 0]
    assignments = np.full((len(ways), len(place), len(second)), -1, np.int64)
    for row, image in zip(assignments, images[ways], strict=True):
        row[:, image[own]] = proposals.assignments[:, own]
    return Proposals(assignments.reshape(-1, len(second)), rotation.reshape(-1, 3, 3), (place - offset).reshape(-1, 3))


@cache_by_identity(256)
@cache_by_values(256)
def _align_ways(first: Floats, second: Floats, images: Integers) -> tuple[NDArray[Any], ...]:
    """How a second body lies in the place of a first one in T ways in which they look alike; see `look_alikes`.

    Returns
    -------
    own : (m,) int array
        The points of the first that correspond.
    ways : (W,) int array
        The way of each motion, one of T.
    motions : (W, 3, 3) array
        From the second body to the first one; reflected where those fit better.
    mirrored : int array
        Which are.
    middle, middles : (3,) and (W, 3) arrays
        Centroids of the corresponding points of both, about the centroids of all.
    """
    own = np.flatnonzero(images[0] >= 0)
    one, others = first[own], second[images[:, own]]
    middle, middles = one.mean(axis=0), others.mean(axis=1)
    one, others = one - middle, others - middles[:, None]
    u, _, vt = np.linalg.svd(others.swapaxes(1, 2) @ one)
    reflected = u @ vt
    turned = np.where((np.linalg.det(reflected) < 0.0)[:, None, None], u * (1.0, 1.0, -1.0), u) @ vt
    misfits = [np.linalg.norm(one @ motions.swapaxes(1, 2) - others, axis=(1, 2)) for motions in (turned, reflected)]
    is_mirror = (np.linalg.det(reflected) < 0.0) & (misfits[1] < misfits[0])
    # a reflection has the same image only from afar, a motion always
    ways = np.repeat(np.arange(len(images)), 1 + (is_mirror & (misfits[0] < FLAT * np.linalg.norm(one))))
    is_mirror = is_mirror[ways] & (np.diff(ways, prepend=-1) > 0)
    motions = np.where(is_mirror[:, None, None], reflected[ways], turned[ways]).swapaxes(1, 2).copy()
    (mirrored,) = np.nonzero(is_mirror)
    return own, ways, motions, mirrored, middle - first.mean(axis=0), middles[ways] - second.mean(axis=0)

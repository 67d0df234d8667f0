"""Strays in space: what several cameras of a rig see in one place, though it is of no body that was asked for.

If the clutter of each camera were independent of that of the others, six cameras that agree about one stray light would
speak for any body that has a point there. So clutter alone is a mixture: of detections of one camera each, and of
strays in space, each a body of a single point.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers, cache_by_values
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.rig_image import RigImage
from rootmatch.deadline import checkpoint
from rootmatch.model.detection_model import DetectionModel
from rootmatch.model.evidence import settle_poses
from rootmatch.model.image_alike import REACH
from rootmatch.model.modes import Modes, used_mask
from rootmatch.model.pose_density import MINIMUM, Broad
from rootmatch.model.priors import WRONG_MODEL
from rootmatch.model.views import camera_frames

ROUNDS = 3
"""How often strays are looked for among what others leave. A round value."""
TOGETHER = 2048
"""Places that are looked about at once. A round value; it bounds memory."""
MAXIMUM = 3
"""Other detections whose lines of sight meet that of each one, the nearest to it: others are looked at among what
strays leave. A round value; it bounds time."""
RIDGE = 1e-12
"""Precision of a place that two parallel lines of sight do not tell, over that across them. A round value."""


class Strays(NamedTuple):
    """T strays that share no detection.

    Attributes
    ----------
    model : DetectionModel
        Of a single point, with the same detections.
    detections : (T, C) int64
        Of each stray in each camera; −1 for none.
    position : (T, 3) float64
    log_odds : (T,) float64
        Of each against detections of single cameras.
    """

    model: DetectionModel
    detections: Integers
    position: Floats
    log_odds: Floats


def stray_log_gains(model: DetectionModel, modes: Modes, predicted: Integers | None = None) -> Floats | float:
    """By how much the log-odds (M,) of a body's modes change as clutter has strays in space.

    What a mode takes of a stray is no stray then, and what it leaves is one as far as two cameras see it. Nothing
    changes for one camera, for modes about predicted poses, which tell where a point is, or where no other mode counts:
    ``predicted`` (M,) says which are, −1 for none.
    """
    if not isinstance(model.camera, RigImage) or len(model.images) < 2 or model.resolution:
        return 0.0
    elsewhere = unpredicted(model, modes, predicted)
    if not (elsewhere & (modes.log_mass > math.log(WRONG_MODEL))).any():
        return 0.0
    strays = find_strays(model)
    if not len(strays.log_odds):
        return 0.0
    uses, gains = modes.uses(model.shape[1])[elsewhere], np.zeros(len(elsewhere))
    own = np.append(uses, np.zeros((len(uses), 1), np.bool_), axis=1)[:, strays.detections]
    left = np.where(own, -1, strays.detections)
    shared = own.any(axis=2)
    log_odds = np.where(shared, -np.inf, strays.log_odds)
    mode, number = (shared & ((left >= 0).sum(axis=2) > 1)).nonzero()
    if len(mode):
        log_odds[mode, number] = _settle(strays.model, left[mode, number], strays.position[number])[0]
    there = log_odds + math.log(len(strays.log_odds)) > 0.0
    every = np.ones((1, len(strays.log_odds)), np.bool_)
    whole = _log_odds_of_all(model, strays.detections[None], strays.log_odds[None], every)[0]
    each = _log_odds_of_all(model, left, log_odds, there, uses)
    gains[elsewhere] = np.logaddexp(each, 0.0) - np.logaddexp(whole, 0.0)
    return gains


def unpredicted(model: DetectionModel, modes: Modes, predicted: Integers | None) -> Bools:
    """Which modes (M,) are about no predicted pose; ``predicted``: see `stray_log_gains`."""
    if predicted is None or model.prior.minimum >= MINIMUM:
        return np.ones(len(modes.log_mass), np.bool_)
    return predicted < 0


def _log_odds_of_all(
    model: DetectionModel, detections: Integers, log_odds: Floats, there: Bools, besides: Bools | None = None
) -> Floats:
    """Log-odds (K,) of several strays at once, ``there`` (K, T), by those (K, T) of each alone.

    Detections are (K, T, C); of those ``besides`` (K, n') none is clutter. The number of strays is a Poisson variable
    with Jeffreys' prior on its rate, as that of clutter in each camera.
    """
    count = model.shape[1]
    besides = np.zeros((len(there), count), np.bool_) if besides is None else besides
    rows, numbers = there.nonzero()
    alone = used_mask(detections[rows, numbers], count)
    taken = besides | used_mask(np.where(there[..., None], detections, -1).reshape(len(there), -1), count)
    each = np.bincount(rows, log_odds[rows, numbers] - model.log_odds_of_left(alone), len(there))
    many = np.array([math.lgamma(k + 0.5) - math.lgamma(0.5) for k in range(there.shape[1] + 1)])
    together = model.log_odds_of_left(taken) - model.log_odds_of_left(besides)
    return np.asarray(each + together + many[there.sum(axis=1)])


def find_strays(model: DetectionModel) -> Strays:
    """The strays in space that the cameras of a rig see, likely ones of which no two share a detection."""
    image = model.camera
    assert isinstance(image, RigImage)
    return _find_strays(
        image.rig, model.target, model.sigma, offsets=image.offsets, camera_of=image.camera_of, unit=image.unit,
        covariance=model.target_covariance, radius=model.radius, freedom=model.noise_freedom,
    )  # fmt: skip


@cache_by_values(8, frozen=False)
def _find_strays(
    rig: Rig,
    target: Floats,
    sigma: Floats,
    *,
    offsets: Floats,
    camera_of: Integers,
    unit: float,
    covariance: Floats | None,
    radius: float,
    freedom: float,
) -> Strays:
    """See `find_strays`; computed once for all searches in an image."""
    image = RigImage(rig, 1, offsets, camera_of, unit)
    model = DetectionModel(
        image, np.zeros((len(offsets), 3)), target, sigma,
        target_covariance=covariance, prior=Broad(radius), noise_freedom=freedom,
    )  # fmt: skip
    found = Strays(model, np.empty((0, len(offsets)), np.int64), np.empty((0, 3)), np.empty(0))
    every_pair, every_place = _meeting_rays(model, rig)
    free, every, before = np.ones(len(target), np.bool_), [found[1:]], 0
    for _ in range(ROUNDS):
        left = np.flatnonzero(free[every_pair].all(axis=1))
        left = left[_nearest(every_pair[left])]
        pairs, places = every_pair[left], every_place[left]
        parts = [slice(k, k + TOGETHER) for k in range(0, len(pairs), TOGETHER)]
        rows = [_seen_about(model, pairs[some], places[some], free) for some in parts]
        candidates, first = np.unique(np.concatenate([found.detections, *rows]), axis=0, return_index=True)
        several = np.count_nonzero(candidates >= 0, axis=1) > 1
        candidates, at = candidates[several], places[first[several]]
        if not len(candidates):
            break
        log_odds, at = _settle(model, candidates, at)
        chosen = _choose(model, candidates, log_odds, before)
        if not len(chosen):
            break
        every.append((candidates[chosen], at[chosen], log_odds[chosen]))
        before += len(chosen)
        free[candidates[chosen][candidates[chosen] >= 0]] = False
    return Strays(model, *(np.concatenate(parts) for parts in zip(*every, strict=True)))


def _choose(model: DetectionModel, detections: Integers, log_odds: Floats, before: int) -> Integers:
    """Which of some strays (K, C) there are, the likeliest first, none sharing a detection; ``before``: known ones."""
    taken, chosen = np.zeros(model.shape[1], np.bool_), list[int]()
    for k in np.argsort(-log_odds, kind="stable").tolist():
        if log_odds[k] + math.log(before + len(chosen) + 0.5) <= 0.0:
            break
        own = detections[k][detections[k] >= 0]
        if not taken[own].any():
            chosen.append(k)
            taken[own] = True
    return np.array(chosen, np.int64)


def _meeting_rays(model: DetectionModel, rig: Rig) -> tuple[Integers, Floats]:
    """Pairs of detections (P, 2) of two cameras whose lines of sight meet within the noise, and where (P, 3).

    Those that come nearest to each other are first.
    """
    rotations, translations = camera_frames(model.camera)
    of, focal = model.image_indices, np.array([one.focal for one in rig.cameras])
    variance = (REACH * model.sigma / focal[of]) ** 2
    rays = np.einsum("nij,ni->nj", rotations[of], model.rays)
    centres = -np.einsum("cij,ci->cj", rotations, translations)
    pairs, places, gaps = [np.empty((0, 2), np.int64)], [np.empty((0, 3))], [np.empty(0)]
    for (a, first), (b, second) in combinations(enumerate(model.images), 2):
        checkpoint()
        between = centres[a] - centres[b]
        along, other = (rays[first] @ between)[:, None], rays[second] @ between
        cosine = rays[first] @ rays[second].T
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (cosine * other - along) / (1.0 - cosine**2)
            near = (other - cosine * along) / (1.0 - cosine**2)
            squared = between @ between + far**2 + near**2 + 2.0 * (far * along - near * other - far * near * cosine)
            maximum = far**2 * variance[first][:, None] + near**2 * variance[second]
            i, j = ((far > 0.0) & (near > 0.0) & (squared < maximum)).nonzero()
        on_first = centres[a] + far[i, j, None] * rays[first[i]]
        on_second = centres[b] + near[i, j, None] * rays[second[j]]
        pairs.append(np.stack([first[i], second[j]], axis=1))
        places.append(0.5 * (on_first + on_second))
        gaps.append(squared[i, j] / maximum[i, j])
    every, where, gap = np.concatenate(pairs), np.concatenate(places), np.concatenate(gaps)
    order = np.argsort(gap, kind="stable")
    return every[order], where[order]


def _nearest(pairs: Integers) -> Bools:
    """Which of some pairs (P, 2), the nearest first, are among the first `MAXIMUM` of one of their detections."""
    kept = np.zeros(len(pairs), np.bool_)
    for one in pairs.T:
        order = np.argsort(one, kind="stable")
        own = one[order]
        kept[order] |= np.arange(len(own)) - np.searchsorted(own, own) < MAXIMUM
    return kept


def _seen_about(model: DetectionModel, pairs: Integers, places: Floats, free: Bools) -> Integers:
    """What each camera sees (K, C) where two detections (K, 2) are of one point near some place (K, 3)."""
    rows = np.arange(len(pairs))
    at = model.linearise_about(np.broadcast_to(np.eye(3), (len(pairs), 3, 3)).copy(), places)
    jacobian, cameras = at.jacobian[..., 3:], model.image_indices[pairs]
    own = jacobian[rows[:, None], cameras] / model.sigma[pairs][..., None, None]
    off = (model.target[pairs] - at.pixels[rows[:, None], cameras]) / model.sigma[pairs][..., None]
    own, off = own.reshape(len(pairs), 4, 3), off.reshape(len(pairs), 4, 1)
    precision = own.swapaxes(1, 2) @ own
    ridge = np.maximum(RIDGE * np.trace(precision, axis1=1, axis2=2), 1e-300)
    spread = np.linalg.inv(precision + ridge[:, None, None] * np.eye(3))
    step = spread @ own.swapaxes(1, 2) @ off
    pixels = at.pixels + (jacobian @ step[:, None])[..., 0]
    across = jacobian @ spread[:, None] @ jacobian.swapaxes(2, 3)
    out = np.full((len(pairs), len(model.images)), -1)
    for k, every in enumerate(model.images):
        those = every[free[every]]
        if not len(those):
            continue
        (a, b), (_, d) = np.moveaxis(across[:, k], 0, 2)[..., None]
        variance, apart = model.sigma[those] ** 2, model.target[those] - pixels[:, k, None]
        a, d, x, y = a + variance, d + variance, apart[..., 0], apart[..., 1]
        squared = (d * x * x - 2.0 * b * x * y + a * y * y) / (a * d - b * b)
        nearest = squared.argmin(axis=1)
        out[:, k] = np.where(at.seen[:, k] & (squared[rows, nearest] < REACH**2), those[nearest], -1)
    out[rows[:, None], cameras] = pairs
    fits = ((off - own @ step)[..., 0] ** 2).sum(axis=1) < REACH**2
    out[~(fits & at.seen[rows[:, None], cameras].all(axis=1))] = -1
    return out


def _settle(model: DetectionModel, detections: Integers, position: Floats) -> tuple[Floats, Floats]:
    """Log-odds (K,) of strays with detections (K, C), and where they are (K, 3), from places near them."""
    found, at = settle_poses(model, detections, np.tile(np.eye(3), (len(position), 1, 1)), np.array(position))
    return found.log_odds, at.position

"""Hypotheses weighed about their poses and led to their best ones, compiled: one call in the place of many.

It is what `rootmatch.model.evidence` does step by step, for cameras that are compiled, points that are no blobs, and
priors that are mixtures of predicted poses and a broad one.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.evidence import weigh_one, weighing_scratch
from rootmatch.model.compiled.known_terms import fill_components, term_buffers
from rootmatch.model.compiled.projection import linearise_one
from rootmatch.model.compiled.same_pose import is_near
from rootmatch.model.compiled.steps import take_one_step
from rootmatch.model.compiled.whitening import whiten_one, whitening_scratch

POSES, IMAGES, EVIDENCE = range(3)
"""What is given of hypotheses: their poses alone, with the images about these, or with the evidence too."""

ONE = 0.1
"""Standard deviations within which two fits of the same matches have ended in one minimum. A round value: their last
steps leave a hundredth of it."""


@part
def drop_behind(log_odds, hopeless, kept):  # type: ignore[no-untyped-def]
    """Do not keep hypotheses that are no better than ``margin`` below the best, or ``floor``, and than ``enough``."""
    margin, floor, enough = hopeless
    best = floor
    for k in range(kept.shape[0]):
        best = max(best, log_odds[k])
    for k in range(kept.shape[0]):
        kept[k] = log_odds[k] > min(best - margin, enough)


@part
def drop_repeated(assignments, poses, covariances, log_odds, kept):  # type: ignore[no-untyped-def]
    """Keep one of several hypotheses, the best or the first one, that have the same matches and end in one minimum."""
    rotations, positions = poses
    nothing = np.zeros(6)
    for k in range(kept.shape[0]):
        for other in range(k):
            if not (kept[k] and kept[other]):
                continue
            same = True
            for i in range(assignments.shape[1]):
                if assignments[k, i] != assignments[other, i]:
                    same = False
                    break
            if not same:
                continue
            first = rotations[k], positions[k], covariances[k]
            if is_near(first, (rotations[other], positions[other], covariances[other]), nothing, ONE):
                kept[other if log_odds[k] > log_odds[other] else k] = False


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def settle_hypotheses(assignments, at, scene, spread, known, limits, out, after):  # type: ignore[no-untyped-def]
    """Evidence of K assignments about poses, and after steps towards the best ones.

    Parameters
    ----------
    assignments : (K, n) int64 array
    at : tuple
        Of `rootmatch.model.linearised.Linearised`: pixels, jacobian, by_position, seen, cosine (no rows if None),
        expected, rotation and position, of K poses, or of one for all assignments, which then take no steps.
    scene : tuple
        The body and the cameras as `linearise` takes them, the image, clutter and rates as `weigh` does.
    spread : tuple
        Covariances of points and detections as `whiten_one` takes them.
    known : tuple
        The prior, as `prior_terms` takes it.
    limits : tuple
        What is given; most steps, and those of every hypothesis; the decrease of Q from which one is taken among those
        and later; log-odds behind the best at which a hypothesis has no later ones; the longest step; and which
        hypotheses are not fitted, as `drop_behind` takes it.
    out : tuple
        Of `rootmatch.model.evidence.Evidence`; filled.
    after : tuple
        Rotations (K, 3, 3) and positions (K, 3) after the last steps, filled; of no rows where they are not asked for.
        If they are, what is not fitted and what repeats another one has log-odds of −∞ in the end.
    """
    assignments, at, scene, spread, known, out, after = borrow((assignments, at, scene, spread, known, out, after))
    pixels, jacobian, by_position, seen, cosine, expected, rotation, position = at
    body, views, image, clutter, rates = scene
    given, maximum, first, small, far, behind, longest, hopeless = limits
    log_odds, steps, decrements = out[0], out[1], out[6]
    count = assignments.shape[0]
    poses = rotation, position
    images = pixels, jacobian, by_position, seen, cosine, expected
    whole = pixels, jacobian, seen, expected, cosine, np.empty((0, 0), np.int64), np.empty((0, 0))
    n, each = assignments.shape[1], count if spread[0].shape[0] + spread[1].shape[0] > 0 else 0
    white = np.empty((each, n, 2, 6)), np.empty((each, n, 2)), np.empty((each, n))
    room_of_white = whitening_scratch(image[4].shape[0])
    room = term_buffers(known)
    terms = room[0]
    scratch = weighing_scratch(assignments.shape[1], image[4].shape[0], image[0].shape[0], rates[0].shape[0])
    going, kept = np.ones(count, np.bool_), np.ones(count, np.bool_)
    for turn in range(0 if given == EVIDENCE else -1, maximum):  # −1: nothing is weighed, so no step is known
        if turn >= 0:
            if turn == 0 and after[1].shape[0] > 0:
                drop_behind(log_odds, hopeless, kept)
            highest, some = -math.inf, False
            for k in range(count):
                if kept[k]:
                    highest = max(highest, log_odds[k])
            for k in range(count):
                enough = kept[k] and decrements[k] >= (small if turn < first else far)
                going[k] = enough and (turn < first or log_odds[k] > highest - behind)
                some = some or going[k]
            if not some:
                break
        for k in range(count):
            if not going[k]:
                continue
            pose = min(k, rotation.shape[0] - 1)
            if turn >= 0:
                take_one_step(k, steps, rotation, position, longest, rotation, position)
            if turn >= 0 or given == POSES:
                linearise_one(pose, body, poses, views, images)
            if k == pose:
                fill_components(pose, poses, known, room)
            if each > 0:
                own = pixels, jacobian, by_position, rotation
                whiten_one(k, pose, assignments, own, image, spread, room_of_white, white)
            weigh_one(k, pose, assignments, whole, white, terms, image, clutter, rates, scratch, out)
    if after[1].shape[0] == 0:
        return
    for k in range(count):
        take_one_step(k, steps, rotation, position, longest, after[0], after[1])
    drop_repeated(assignments, after, out[2], log_odds, kept)
    for k in range(count):
        if not kept[k]:
            log_odds[k] = -math.inf

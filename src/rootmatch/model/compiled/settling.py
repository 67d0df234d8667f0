"""Hypotheses weighed about their poses and led to their best ones, compiled: one call in the place of many.

It is what `rootmatch.model.evidence` does step by step, for cameras that are compiled, noise of each detection alone,
and priors that are mixtures of predicted poses and a broad one.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrowed
from rootmatch.jit.decorators import FASTMATH, driver
from rootmatch.model.compiled.evidence import scratch_for, weigh_one
from rootmatch.model.compiled.known_terms import components_about, room_for_terms
from rootmatch.model.compiled.projection import linearise_one
from rootmatch.model.compiled.steps import step_of_one

POSES, IMAGES, EVIDENCE = range(3)
"""What is given of hypotheses: their poses alone, with the images about these, or with the evidence too."""


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def settle(assignments, at, scene, known, limits, out):  # type: ignore[no-untyped-def]
    """Evidence of K assignments about poses, and after steps towards the best ones.

    Parameters
    ----------
    assignments : (K, n) int64 array
    at : tuple
        Of `rootmatch.model.linearised.Linearised`: pixels, jacobian, by_position, seen, cosine (no rows if None),
        expected, rotation and position, of K poses, or of one for all assignments, which then take no steps.
    scene : tuple
        The body and the cameras as `linearise` takes them, the image, clutter and rates as `weigh` does.
    known : tuple
        The prior, as `prior_terms` takes it.
    limits : tuple
        What is given; most steps, and those of every hypothesis; the decrease of Q from which one is taken among those
        and later; log-odds behind the best at which a hypothesis has no later ones; and the longest step.
    out : tuple
        Of `rootmatch.model.evidence.Evidence`; filled.
    """
    assignments, at, scene, known, out = borrowed((assignments, at, scene, known, out))
    pixels, jacobian, by_position, seen, cosine, expected, rotation, position = at
    body, views, image, clutter, rates = scene
    given, most, first, small, far, behind, longest = limits
    log_odds, steps, decrements = out[0], out[1], out[6]
    count = assignments.shape[0]
    poses = rotation, position
    images = pixels, jacobian, by_position, seen, cosine, expected
    whole = pixels, jacobian, seen, expected, cosine, np.empty((0, 0), np.int64), np.empty((0, 0))
    white = np.empty((0, 0, 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0))
    room = room_for_terms(known)
    terms = room[0]
    scratch = scratch_for(assignments.shape[1], image[4].shape[0], image[0].shape[0])
    going = np.ones(count, np.bool_)
    for turn in range(0 if given == EVIDENCE else -1, most):  # −1: nothing is weighed, so no step is known
        if turn >= 0:
            highest, some = -math.inf, False
            for k in range(count):
                highest = max(highest, log_odds[k])
            for k in range(count):
                enough = decrements[k] >= (small if turn < first else far)
                going[k] = enough and (turn < first or log_odds[k] > highest - behind)
                some = some or going[k]
            if not some:
                break
        for k in range(count):
            if not going[k]:
                continue
            pose = min(k, rotation.shape[0] - 1)
            if turn >= 0:
                step_of_one(k, steps, rotation, position, longest, rotation, position)
            if turn >= 0 or given == POSES:
                linearise_one(pose, body, poses, views, images)
            if k == pose:
                components_about(pose, poses, known, room)
            weigh_one(k, pose, assignments, whole, white, terms, image, clutter, rates, scratch, out)

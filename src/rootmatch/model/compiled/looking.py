"""Assignments about a predicted pose and the poses that they lead to, compiled: a prediction in one call.

It is what `rootmatch.model.prediction` does step by step, for what `rootmatch.model.compiled.settling` is for.
"""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.evidence import weigh_one, weighing_scratch
from rootmatch.model.compiled.gating import fill_gates
from rootmatch.model.compiled.known_terms import fill_components, term_buffers
from rootmatch.model.compiled.projection import linearise_one
from rootmatch.model.compiled.steps import take_one_step
from rootmatch.model.compiled.visibility import fill_visibility_of_pose


@part
def is_equal_row(first, second):  # type: ignore[no-untyped-def]
    """Whether two assignments (n,) are the same."""
    same = True
    for i in range(first.shape[0]):
        same = same and first[i] == second[i]
    return same


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def follow_gates(covariance, scene, known, limits, at, out, near):  # type: ignore[no-untyped-def]
    """Assignment and step in turn, from a predicted pose, until the assignment stays.

    Parameters
    ----------
    covariance : (6, 6) array
        Of the prediction, and in the end that about the last pose that was looked about; changed.
    scene, known : tuple
        As for `rootmatch.model.compiled.settling.settle`.
    limits : tuple of float
        Squared gate, the detection rate, the least visibility of a point with candidates, most candidates about the
        first pose, and the longest step.
    at : tuple
        Images about T + 1 poses, as for `settle`: the predicted one the first, then where each assignment leads to;
        filled.
    out : tuple
        Assignments (T, n), and their evidence about these poses; filled.
    near : tuple
        Candidates (n, n') about the first pose and visibility (n,) there; candidates (n, n') about the last one, their
        gains (n, n'), and the assignment (n,) by them; filled.

    Returns
    -------
    int
        How many assignments were made: none if nothing or too much is near.
    """
    covariance, scene, known, at, out, near = borrow((covariance, scene, known, at, out, near))
    pixels, jacobian, by_position, seen, cosine, expected, rotation, position = at
    body, views, image, clutter, rates = scene
    assignments, weighed = out
    first, first_visible, candidates, gains, row = near
    squared_gate, rate, hidden, maximum, longest = limits
    target, sigma, log_weights, view_cosine = image[0], image[1], image[2], image[3]
    n, poses = assignments.shape[1], (rotation, position)
    images = pixels, jacobian, by_position, seen, cosine, expected
    whole = pixels, jacobian, seen, expected, cosine, np.empty((0, 0), np.int64), np.empty((0, 0))
    white = np.empty((0, 0, 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0))
    isotropic = np.empty((0, 2, 2))
    exact, visible = np.empty((0, 2, 2)), np.empty(n)
    room = term_buffers(known)
    terms = room[0]
    scratch = weighing_scratch(n, image[4].shape[0], target.shape[0], rates[0].shape[0])
    for turn in range(assignments.shape[0]):
        linearise_one(turn, body, poses, views, images)
        tilt = 0.5 * (covariance[0, 0] + covariance[1, 1] + covariance[2, 2])
        tilt = min(math.sqrt(max(tilt, 0.0)), 1.0)
        fill_visibility_of_pose(turn, expected[turn], cosine, view_cosine, tilt, visible)
        fill_gates(
            (pixels[turn], jacobian[turn], exact, visible),
            covariance,
            (target, sigma, isotropic, clutter[0], log_weights),
            (squared_gate, rate, hidden),
            (candidates, gains, row),
        )
        if turn == 0:
            count = 0
            for i in range(n):
                first_visible[i] = visible[i]
                for j in range(target.shape[0]):
                    first[i, j] = candidates[i, j]
                    count += candidates[i, j]
            if not 0 < count <= maximum:
                return 0
        matched = 0
        for i in range(n):
            assignments[turn, i] = row[i]
            matched += row[i] >= 0
        if matched == 0:
            return turn
        for before in range(turn):
            if is_equal_row(assignments[before], row):
                return turn
        fill_components(turn, poses, known, room)
        weigh_one(turn, turn, assignments, whole, white, terms, image, clutter, rates, scratch, weighed)
        total = 0.0
        for i in range(n):
            total += weighed[5][turn, i]
        # from this pose into the place of the next one
        take_one_step(turn, weighed[1], rotation, position, longest, rotation[1:], position[1:])
        if matched >= total:  # nothing is left to assign
            return turn + 1
        if turn + 1 < assignments.shape[0]:
            for p in range(6):
                for q in range(6):
                    covariance[p, q] = weighed[2][turn, p, q]
    return assignments.shape[0]

"""Terms of what is known of a pose in part, compiled: the formulas of `rootmatch.model.known_density`."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.prior_terms import fill_broad_terms, fill_largest_terms, rotation_vector_between


@part
def add_turn(weight, step, terms, row):  # type: ignore[no-untyped-def]
    """Add a known rotation, a ``step`` away, to a row of terms."""
    precision, slope, squared, _ = terms
    for a in range(3):
        push = 0.0
        for b in range(3):
            push += weight[a, b] * step[b]
            precision[row, a, b] += weight[a, b]
        slope[row, a] += push
        squared[row] += step[a] * push


@part
def add_direction(source, camera, concentration, R, terms, row):  # type: ignore[no-untyped-def]
    """Replace any rotation in a row of terms by those with a known direction."""
    precision, slope, squared, _ = terms
    x = R[0, 0] * source[0] + R[0, 1] * source[1] + R[0, 2] * source[2]
    y = R[1, 0] * source[0] + R[1, 1] * source[1] + R[1, 2] * source[2]
    z = R[2, 0] * source[0] + R[2, 1] * source[1] + R[2, 2] * source[2]
    now = (x, y, z)
    # a turn about the direction is any of 2π; the volume across is that of the density, at most all directions
    about, across = 0.5 / math.pi, -concentration / math.expm1(-2.0 * concentration)
    for a in range(3):
        for b in range(3):
            precision[row, a, b] = (across if a == b else 0.0) + (about - across) * now[a] * now[b]
    u, v, w = camera[0] - x, camera[1] - y, camera[2] - z
    chord2 = u * u + v * v + w * w
    # a turn as long as the chord: to first order it takes away the whole deviation, however many σ that is
    pull = concentration / math.sqrt(max(1.0 - 0.25 * chord2, 1e-6))
    slope[row, 0] += pull * (y * camera[2] - z * camera[1])
    slope[row, 1] += pull * (z * camera[0] - x * camera[2])
    slope[row, 2] += pull * (x * camera[1] - y * camera[0])
    squared[row] += concentration * chord2


@part
def add_place(place, weight, centre, R, position, scratch, terms, row):  # type: ignore[no-untyped-def]
    """Add a known position of the origin to a row of terms, whose steps move the centre.

    The broad prior's own precision is of the origin then, so that a rotation which nothing determines stays as it is.
    """
    precision, slope, squared, _ = terms
    turn, off, push = scratch[0], scratch[1][0], scratch[1][1]
    arm = (
        R[0, 0] * centre[0] + R[0, 1] * centre[1] + R[0, 2] * centre[2],
        R[1, 0] * centre[0] + R[1, 1] * centre[1] + R[1, 2] * centre[2],
        R[2, 0] * centre[0] + R[2, 1] * centre[1] + R[2, 2] * centre[2],
    )
    for a in range(3):
        off[a] = place[a] - position[a] + arm[a]
        # how the origin moves with a turn: [arm]×
        before, after = (a + 2) % 3, (a + 1) % 3
        turn[a, a], turn[a, after], turn[a, before] = 0.0, -arm[before], arm[after]
    for a in range(3):
        push[a] = 0.0
        for b in range(3):
            push[a] += weight[a, b] * off[b]
        squared[row] += push[a] * off[a]
    for a in range(3):
        slope[row, 3 + a] += push[a]
        for b in range(3):
            slope[row, a] += turn[b, a] * push[b]
            precision[row, 3 + a, 3 + b] += weight[a, b]
    for a in range(3):
        for b in range(3):
            mixed = 0.0
            for c in range(3):
                mixed += precision[row, 3 + a, 3 + c] * turn[c, b]
            precision[row, 3 + a, b] = precision[row, b, 3 + a] = mixed
    for a in range(3):
        for b in range(3):
            for c in range(3):
                precision[row, a, b] += turn[c, a] * precision[row, 3 + c, b]


@part
def term_buffers(known):  # type: ignore[no-untyped-def]
    """Rows for the terms of each component of a prior, which prediction the first of them is, and scratch."""
    rows = 1 + known[2][3].shape[0]
    terms = np.empty((rows, 6, 6)), np.empty((rows, 6)), np.empty(rows), np.empty(rows)
    return terms, np.empty(1, np.int64), (np.empty((3, 3)), np.empty((4, 6)), np.empty((4, 6, 6)))


@part
def fill_components(k, poses, known, room):  # type: ignore[no-untyped-def]
    """Terms of each component of a prior about the k-th of some poses, into ``room``.

    The first row is of the largest of the predictions and the broad prior, each other one of a piece of knowledge.
    """
    predictions, broad, ((means, turn_weights), directions, (places, place_weights, centres), peaks) = known
    sources, cameras, concentrations = directions
    terms, which, scratch = room
    rotations, positions = poses
    fill_largest_terms(k, 0, poses, predictions, broad, scratch, terms, which)
    step = scratch[1][0]
    for m in range(peaks.shape[0]):
        fill_broad_terms(k, 1 + m, positions, broad, peaks[m], terms)
        if turn_weights[m, 0, 0] > 0.0:
            rotation_vector_between(means[m], rotations[k], scratch[0], step)
            add_turn(turn_weights[m], step, terms, 1 + m)
        elif concentrations[m] > 0.0:
            add_direction(sources[m], cameras[m], concentrations[m], rotations[k], terms, 1 + m)
        if place_weights[m, 0, 0] > 0.0:
            add_place(places[m], place_weights[m], centres[m], rotations[k], positions[k], scratch, terms, 1 + m)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def fill_prior_terms(poses, known, out, which):  # type: ignore[no-untyped-def]
    """Terms of each component of a prior about each of K poses.

    Parameters
    ----------
    poses : tuple
        Rotations (K, 3, 3), and positions (K, 3).
    known : tuple
        Of `rootmatch.model.pose_density.Mixture`.
    out : tuple
        Of `rootmatch.model.pose_density.Terms`, (K, C, …): the largest of predictions and the broad prior first, then
        each piece of knowledge; filled.
    which : (K,) int64 array
        The largest prediction, their number for the broad prior; filled.
    """
    poses, known, out, which = borrow((poses, known, out, which))
    room = term_buffers(known)
    terms, first, _ = room
    for k in range(which.shape[0]):
        fill_components(k, poses, known, room)
        which[k] = first[0]
        for row in range(terms[2].shape[0]):
            out[2][k, row], out[3][k, row] = terms[2][row], terms[3][row]
            for a in range(6):
                out[1][k, row, a] = terms[1][row, a]
                for b in range(6):
                    out[0][k, row, a, b] = terms[0][row, a, b]

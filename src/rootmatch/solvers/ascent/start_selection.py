"""Selection of starts: which differ, which lie in known assignments, and which go together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.jit.decorators import driver
from rootmatch.solvers.ascent.assignment_state import State


def next_starts(
    candidates: NDArray[np.int32], open_: Bools, images: Integers, n_target: int, *, minimum: int, count: int
) -> Integers:
    """Up to `count` open candidates (rows of flat indices), in order, no two with more than one entry in common.

    First those are closed that have at least `minimum` correspondences in one of some assignments (B, n), and at last
    those that are returned.
    """
    chosen = np.empty(count, np.int64)
    return chosen[: int(_select(candidates, open_, images, n_target, minimum, chosen))]


def lies_within_assignments(candidates: NDArray[np.int32], images: Integers, n_target: int, minimum: int) -> Bools:
    """Which candidates have at least `minimum` correspondences in one of some assignments (B, n)."""
    outside = np.ones(len(candidates), np.bool_)
    _select(candidates, outside, images, n_target, minimum, np.empty(0, np.int64))
    return ~outside


@driver(nogil=True)
def _select(candidates, open_, images, n_target, minimum, chosen):  # type: ignore[no-untyped-def]
    """Close what lies within the assignments, and fill in what is selected as far as it fits; its number."""
    order = candidates.shape[1]
    source, target = np.empty(order, np.int64), np.empty(order, np.int64)
    for c in range(open_.size):
        if images.shape[0] == 0 or not open_[c]:
            continue
        for p in range(order):
            source[p] = candidates[c, p] // n_target
            target[p] = candidates[c, p] - source[p] * n_target
        for b in range(images.shape[0]):
            hits = 0
            for p in range(order):
                hits += images[b, source[p]] == target[p]
            if hits >= minimum:
                open_[c] = False
                break
    count = 0
    for c in range(open_.size):
        if count == chosen.size:
            break
        fits = open_[c]
        for s in range(count):
            common = 0
            for p in range(order):
                for q in range(order):
                    common += candidates[c, p] == candidates[chosen[s], q]
            fits = fits and common <= 1
            if not fits:
                break
        if fits:
            chosen[count] = c
            count += 1
    for s in range(count):
        open_[chosen[s]] = False
    return count


def are_cores_covered(cores: Integers, known: Integers) -> Bools:
    """Which cores (B, n) lie in one of the known assignments (F, n)."""
    out = np.zeros(len(cores), np.bool_)
    for image in known:
        out |= ((cores < 0) | (cores == image)).all(axis=1)
    return out


def pack_cores(cores: Integers, n: int, n_target: int) -> Integers:
    """The assignment (n,) of all cores, in order, that contradict none that was taken before."""
    image, owner = np.full(n, -1), np.full(n_target, -1)
    for core in cores:
        i = np.flatnonzero(core >= 0)
        k = core[i]
        if np.all((image[i] < 0) | (image[i] == k)) and np.all((owner[k] < 0) | (owner[k] == i)):
            image[i], owner[k] = k, i
    return image


def force_cores(
    state: State, cores: Integers, values: Floats, first: int, *, forced_gain: float, count: int
) -> tuple[Integers, int]:
    """The assignment of a state with one core forced into it, up to `count` times, from core `first` on.

    Cores are used whose value is more than `forced_gain` times what they displace, the gains of the members in their
    way. Returns the assignments (B, n) and the number of the next core.
    """
    base, owner = state.image, state.owner
    matched, own = np.flatnonzero(base >= 0), np.zeros(base.size)
    own[matched] = state.gains.reshape(base.size, -1)[matched, base[matched]]
    cores, values = cores[first:], values[first:]
    new = (cores >= 0) & (cores != base)
    # Whose own target is given up or taken; one that is both is lost once.
    out = new & (base >= 0)
    b, i = np.nonzero(new)
    j = owner[cores[b, i]]
    out[b[j >= 0], j[j >= 0]] = True
    used = np.flatnonzero(new.any(axis=1) & (values > forced_gain * (out @ own)))[:count]
    bases = np.where(new[used], cores[used], np.where(out[used], -1, base))
    return bases, first + (int(used[-1]) + 1 if len(used) == count else len(cores))

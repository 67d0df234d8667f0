"""Which starts differ, which are known already, and which go together: small loops of the multi-start search."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def different(candidates: NDArray[Any], open_: NDArray[Any], count: int) -> NDArray[Any]:
    """Up to `count` open candidates (rows of flat indices), in order, no two with more than one entry in common."""
    chosen = np.empty(count, np.int64)
    found, order = 0, candidates.shape[1]
    for c in range(candidates.shape[0]):
        if found == count:
            break
        fresh = open_[c]
        for s in range(found):
            if not fresh:
                break
            common = 0
            for p in range(order):
                for q in range(order):
                    common += candidates[c, p] == candidates[chosen[s], q]
            fresh = common <= 1
        if fresh:
            chosen[found] = c
            found += 1
    return chosen[:found]


@njit(cache=True)
def within(candidates: NDArray[Any], images: NDArray[Any], n_target: int, least: int) -> NDArray[Any]:
    """Which candidates have at least `least` correspondences in one of some assignments (B, n)."""
    out = np.zeros(candidates.shape[0], np.bool_)
    for c in range(candidates.shape[0]):
        for s in range(images.shape[0]):
            common = 0
            for p in range(candidates.shape[1]):
                i = candidates[c, p] // n_target
                common += images[s, i] == candidates[c, p] - i * n_target
            if common >= least:
                out[c] = True
                break
    return out


@njit(cache=True)
def covered(cores: NDArray[Any], known: NDArray[Any]) -> NDArray[Any]:
    """Which cores (B, n) lie in one of the known assignments (F, n)."""
    out = np.zeros(cores.shape[0], np.bool_)
    for c in range(cores.shape[0]):
        for s in range(known.shape[0]):
            i = 0
            while i < cores.shape[1] and (cores[c, i] < 0 or cores[c, i] == known[s, i]):
                i += 1
            if i == cores.shape[1]:
                out[c] = True
                break
    return out


@njit(cache=True)
def packed(cores: NDArray[Any], n: int, n_target: int) -> NDArray[Any]:
    """The assignment (n,) of all cores, in order, that contradict none that was taken before."""
    image, owner = np.full(n, -1, np.int64), np.full(n_target, -1, np.int64)
    for c in range(cores.shape[0]):
        fits = True
        for i in range(n):
            k = cores[c, i]
            if k >= 0 and ((image[i] >= 0 and image[i] != k) or (owner[k] >= 0 and owner[k] != i)):
                fits = False
                break
        if fits:
            for i in range(n):
                if cores[c, i] >= 0:
                    image[i], owner[cores[c, i]] = cores[c, i], i
    return image


@njit(cache=True)
def forced(
    base: NDArray[Any],
    gains: NDArray[Any],
    cores: NDArray[Any],
    values: NDArray[Any],
    n_target: int,
    worth: float,
    first: int,
    count: int,
) -> tuple[NDArray[Any], int]:
    """Assignments made of `base` (n,) with a core put in by force, up to `count`, from core `first` on.

    Those cores are used whose value is more than `worth` times what they push out, the gains (n n',) of the members in
    their way. Returns the assignments (B, n) and the number of the next core.
    """
    n = base.size
    bases = np.empty((count, n), np.int64)
    found, c = 0, first
    while c < cores.shape[0] and found < count:
        image = bases[found]
        image[:] = base
        loss, new = 0.0, False
        for i in range(n):
            k = cores[c, i]
            if k < 0 or image[i] == k:
                continue
            new = True
            if image[i] >= 0:
                loss += gains[i * n_target + image[i]]
            for j in range(n):
                if image[j] == k:
                    loss += gains[j * n_target + k]
                    image[j] = -1
            image[i] = k
        c += 1
        if new and values[c - 1] > worth * loss:
            found += 1
    return bases[:found], c

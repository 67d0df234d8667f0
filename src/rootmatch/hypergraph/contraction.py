"""Passes over all hyper-edges of a sparse affinity tensor: contraction, score, validation.

A tensor holds each hyper-edge once: d flat indices a = i·n' + i' and a weight h. Its contraction by a soft
assignment x is v_a = Σ_{e∋a} h_e Π_{b∈e, b≠a} x_b (Duchenne, Bach, Kweon and Ponce, A tensor-based algorithm for
high-order graph matching, PAMI 2011).

The hyper-edges are cut into a number of chunks that depends on the tensor alone. Each chunk adds into a table of its
own and the tables are summed in order, so the result is the same to the last bit for any number of threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.jit.decorators import driver
from rootmatch.jit.threads import chunk_bounds, run_in_threads, worthwhile_threads

CHUNK = 32768
"""Hyper-edges a chunk: about a tenth of a millisecond, which outweighs the start of a thread
(`rootmatch benchmark`, contraction)."""

MAX_CHUNKS = 64

VALID, OUT_OF_RANGE, SHARED_SOURCE, SHARED_TARGET, BAD_WEIGHT = 0, 1, 2, 3, 4
"""Verdicts of `first_fault`."""

USUALLY_INSIDE = 4096
"""Hyper-edges inside an assignment that the first pass can hold; beyond, a second pass follows. Not tuned."""


def contract(indices: NDArray[np.int32], weights: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Contraction v (n n',) of the hyper-edges (E, d) by x (n n',)."""
    chunks = _chunk_count(weights.size, x.size)
    tables = np.zeros((chunks, 2, x.size))
    if chunks == 1:
        _scatter(indices, weights, x, 0, weights.size, tables[0])
        return np.asarray(tables[0, 0] + tables[0, 1])

    bounds = chunk_bounds(0, weights.size, chunks)

    def add(first: int, last: int) -> None:
        for chunk in range(first, last):
            _scatter(indices, weights, x, bounds[chunk], bounds[chunk + 1], tables[chunk])

    run_in_threads(add, chunks, worthwhile_threads(chunks))
    return np.asarray(tables.sum(axis=1).sum(axis=0))


def _chunk_count(hyperedges: int, correspondences: int) -> int:
    """Chunks of a contraction: enough to share among threads, few enough that clearing their tables costs nothing."""
    return max(1, min(hyperedges // CHUNK, MAX_CHUNKS, hyperedges // correspondences))


@driver(nogil=True, error_model="numpy")
def _scatter(indices, weights, x, first, last, tables):  # type: ignore[no-untyped-def]
    """Add the contraction of hyper-edges first…last−1 into the sum of two tables (2, n n').

    Neighbouring hyper-edges of a sorted tensor share most of their correspondences. Two tables taken in turn keep the
    processor from waiting for the sum it has just stored: 1.5 against 3.1 ms for a million sorted triples.
    """
    order = indices.shape[1]
    if order == 3:
        for e in range(first, last):
            t = e & 1
            a, b, c, h = indices[e, 0], indices[e, 1], indices[e, 2], weights[e]
            xa, xb, xc = x[a], x[b], h * x[c]
            tables[t, a] += xb * xc
            tables[t, b] += xa * xc
            tables[t, c] += h * (xa * xb)
    elif order == 4:
        for e in range(first, last):
            t = e & 1
            a, b, c, d, h = indices[e, 0], indices[e, 1], indices[e, 2], indices[e, 3], weights[e]
            xa, xb, xc, xd = x[a], x[b], x[c], x[d]
            ab, cd = h * (xa * xb), h * (xc * xd)
            tables[t, a] += xb * cd
            tables[t, b] += xa * cd
            tables[t, c] += xd * ab
            tables[t, d] += xc * ab
    else:
        # Products of all but one: those before, times those after, without a division that a zero would spoil.
        before = np.empty(order)
        for e in range(first, last):
            t = e & 1
            product = weights[e]
            for p in range(order):
                before[p] = product
                product *= x[indices[e, p]]
            product = 1.0
            for p in range(order - 1, -1, -1):
                a = indices[e, p]
                tables[t, a] += before[p] * product
                product *= x[a]


def find_inside(indices: NDArray[np.int32], chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Numbers of the hyper-edges all of whose correspondences are chosen, (n n',)."""
    count = min(len(indices), USUALLY_INSIDE)
    while True:
        edges = np.empty(count, np.int64)
        count = int(_find_inside(indices, chosen, edges))
        if count <= edges.size:
            return edges[:count]


@driver(nogil=True)
def _find_inside(indices, chosen, edges):  # type: ignore[no-untyped-def]
    """Fill in what is inside as far as the array reaches, and count all of it."""
    count = 0
    for e in range(indices.shape[0]):
        p = 0
        while p < indices.shape[1] and chosen[indices[e, p]]:
            p += 1
        if p == indices.shape[1]:
            if count < edges.size:
                edges[count] = e
            count += 1
    return count


def first_fault(indices: NDArray[np.int32], weights: NDArray[np.float64], n: int, n_target: int) -> tuple[int, int]:
    """Verdict and number of the first hyper-edge that is no good; `VALID` and −1 when all are."""
    found: list[tuple[int, int]] = []

    def look(first: int, last: int) -> None:
        verdict, edge = _first_fault(indices, weights, n, n_target, first, last)
        if verdict != VALID:
            found.append((int(edge), int(verdict)))

    run_in_threads(look, weights.size, worthwhile_threads(weights.size // CHUNK))
    edge, verdict = min(found, default=(-1, VALID))
    return verdict, edge


@driver(nogil=True, error_model="numpy")
def _first_fault(indices, weights, n, n_target, first, last):  # type: ignore[no-untyped-def]
    """Verdict and number of the first hyper-edge of first…last−1 that is no good."""
    for e in range(first, last):
        for p in range(indices.shape[1]):
            a = indices[e, p]
            if a < 0 or a >= n * n_target:
                return OUT_OF_RANGE, e
            i = a // n_target
            k = a - i * n_target
            for q in range(p):
                j = indices[e, q] // n_target
                if i == j:
                    return SHARED_SOURCE, e
                if k == indices[e, q] - j * n_target:
                    return SHARED_TARGET, e
        # Written so that NaN fails too.
        if not (0.0 <= weights[e] < np.inf):
            return BAD_WEIGHT, e
    return VALID, -1

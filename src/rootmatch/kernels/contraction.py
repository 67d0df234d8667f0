"""Passes over all hyper-edges of a sparse affinity tensor: contraction, score, validation.

A tensor holds each hyper-edge once: d flat indices a = i·n' + i' and a weight h. Its contraction by a soft
assignment x is v_a = Σ_{e∋a} h_e Π_{b∈e, b≠a} x_b (Duchenne, Bach, Kweon and Ponce, A tensor-based algorithm for
high-order graph matching, PAMI 2011).

The hyper-edges are cut into a number of chunks that depends on the tensor alone. Each chunk adds into a table of its
own and the tables are summed in order, so the result is the same to the last bit for any number of threads.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

CHUNK = 32768
"""Hyper-edges a chunk: about a tenth of a millisecond, which outweighs the start of a thread."""

MOST_CHUNKS = 64

VALID, OUT_OF_RANGE, SHARED_SOURCE, SHARED_TARGET, BAD_WEIGHT = 0, 1, 2, 3, 4
"""Verdicts of `first_fault`."""


def chunk_count(edges: int, correspondences: int) -> int:
    """Chunks for a tensor: enough to share among threads, few enough that clearing their tables costs nothing."""
    return max(1, min(edges // CHUNK, MOST_CHUNKS, edges // max(1, correspondences)))


@contextmanager
def threads_for(tasks: int) -> Iterator[None]:
    """Let parallel functions inside use as many threads as there are tasks worth one, and no more than allowed.

    Waking threads for a few microseconds of work costs more than the work, and far more on a busy machine.
    """
    allowed = numba.get_num_threads()
    numba.set_num_threads(max(1, min(allowed, tasks)))
    try:
        yield
    finally:
        numba.set_num_threads(allowed)


@njit(cache=True, error_model="numpy")
def _scatter(indices, weights, x, first, last, even, odd):  # type: ignore[no-untyped-def]
    """Add the contraction of hyper-edges first…last−1 into the sum of two tables.

    Neighbouring hyper-edges of a sorted tensor share most of their correspondences. Two tables taken in turn keep the
    processor from waiting for the sum it has just stored: 1.5 against 3.1 ms for a million sorted triples.
    """
    order = indices.shape[1]
    if order == 2:
        for e in range(first, last):
            v = even if e & 1 == 0 else odd
            a, b, h = indices[e, 0], indices[e, 1], weights[e]
            v[a] += h * x[b]
            v[b] += h * x[a]
    elif order == 3:
        pairs = (last - first) // 2
        for t in range(pairs + 1):
            e = first + 2 * t
            if e < last:
                a, b, c, h = indices[e, 0], indices[e, 1], indices[e, 2], weights[e]
                xa, xb, xc = x[a], x[b], h * x[c]
                even[a] += xb * xc
                even[b] += xa * xc
                even[c] += h * (xa * xb)
            if e + 1 < last:
                a, b, c, h = indices[e + 1, 0], indices[e + 1, 1], indices[e + 1, 2], weights[e + 1]
                xa, xb, xc = x[a], x[b], h * x[c]
                odd[a] += xb * xc
                odd[b] += xa * xc
                odd[c] += h * (xa * xb)
    elif order == 4:
        for e in range(first, last):
            v = even if e & 1 == 0 else odd
            a, b, c, d, h = indices[e, 0], indices[e, 1], indices[e, 2], indices[e, 3], weights[e]
            xa, xb, xc, xd = x[a], x[b], x[c], x[d]
            ab, cd = h * (xa * xb), h * (xc * xd)
            v[a] += xb * cd
            v[b] += xa * cd
            v[c] += xd * ab
            v[d] += xc * ab
    else:
        # Products of all but one: those before, times those after, without a division that a zero would spoil.
        before = np.empty(order)
        for e in range(first, last):
            product = weights[e]
            for p in range(order):
                before[p] = product
                product *= x[indices[e, p]]
            product = 1.0
            for p in range(order - 1, -1, -1):
                a = indices[e, p]
                even[a] += before[p] * product
                product *= x[a]


@njit(cache=True, error_model="numpy")
def contract_serial(indices: NDArray[Any], weights: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
    """Contraction of a small tensor on the calling thread."""
    even, odd = np.zeros(x.size), np.zeros(x.size)
    _scatter(indices, weights, x, 0, weights.size, even, odd)
    return even + odd


@njit(cache=True, parallel=True, error_model="numpy")
def contract_parallel(indices: NDArray[Any], weights: NDArray[Any], x: NDArray[Any], chunks: int) -> NDArray[Any]:
    """Contraction by several threads, one table pair a chunk."""
    tables = np.zeros((chunks, 2, x.size))
    edges = weights.size
    for chunk in prange(chunks):
        first, last = chunk * edges // chunks, (chunk + 1) * edges // chunks
        _scatter(indices, weights, x, first, last, tables[chunk, 0], tables[chunk, 1])
    out = np.zeros(x.size)
    for chunk in range(chunks):
        for a in range(x.size):
            out[a] += tables[chunk, 0, a] + tables[chunk, 1, a]
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def inside_score(indices: NDArray[Any], weights: NDArray[Any], chosen: NDArray[Any], chunks: int) -> float:
    """Sum of the weights of the hyper-edges all of whose correspondences are chosen (boolean, (n n',))."""
    edges, order = indices.shape
    sums = np.zeros(chunks)
    for chunk in prange(chunks):
        total = 0.0
        for e in range(chunk * edges // chunks, (chunk + 1) * edges // chunks):
            inside = True
            for p in range(order):
                inside = inside and chosen[indices[e, p]]
            if inside:
                total += weights[e]
        sums[chunk] = total
    score = 0.0
    for chunk in range(chunks):
        score += sums[chunk]
    return score


@njit(cache=True)
def inside_edges(indices: NDArray[Any], chosen: NDArray[Any]) -> NDArray[Any]:
    """Numbers of the hyper-edges all of whose correspondences are chosen (boolean, (n n',))."""
    edges, order = indices.shape
    found, count = np.empty(256, np.int64), 0
    for e in range(edges):
        p = 0
        while p < order and chosen[indices[e, p]]:
            p += 1
        if p == order:
            if count == found.size:
                longer = np.empty(2 * count, np.int64)
                longer[:count] = found
                found = longer
            found[count] = e
            count += 1
    return found[:count]


@njit(cache=True, error_model="numpy")
def _fault(indices, weights, n, n_target, e):  # type: ignore[no-untyped-def]
    """Verdict on one hyper-edge."""
    order = indices.shape[1]
    for p in range(order):
        a = indices[e, p]
        if a < 0 or a >= n * n_target:
            return OUT_OF_RANGE
        i = a // n_target
        k = a - i * n_target
        for q in range(p):
            j = indices[e, q] // n_target
            if i == j:
                return SHARED_SOURCE
            if k == indices[e, q] - j * n_target:
                return SHARED_TARGET
    # Written so that NaN fails too.
    return VALID if 0.0 <= weights[e] < np.inf else BAD_WEIGHT


@njit(cache=True, parallel=True, error_model="numpy")
def first_fault(indices: NDArray[Any], weights: NDArray[Any], n: int, n_target: int, chunks: int) -> tuple[int, int]:
    """Verdict and number of the first hyper-edge that is no good; `VALID` and −1 when all are."""
    edges = weights.size
    where = np.full(chunks, -1, np.int64)
    for chunk in prange(chunks):
        for e in range(chunk * edges // chunks, (chunk + 1) * edges // chunks):
            if _fault(indices, weights, n, n_target, e) != VALID:
                where[chunk] = e
                break
    for chunk in range(chunks):
        if where[chunk] >= 0:
            return _fault(indices, weights, n, n_target, where[chunk]), where[chunk]
    return VALID, -1

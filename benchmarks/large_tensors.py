"""Solvers on planted tensors of order 4 with up to 10⁸ hyper-edges, side by side.

    python benchmarks/large_tensors.py --hyperedges 1e6 1e7 1e8

A planted tensor holds hyper-edges of a true assignment of n points, with weights exp(−χ²/2), among random false ones.
"share" of the true ones are there: with few of them no solver finds the assignment, and the time is what a hopeless
tensor takes. 10⁸ hyper-edges take 9 GB of memory. Times are those of the clock on the wall, on all threads allowed.
"""

from __future__ import annotations

import resource
from itertools import combinations
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from shared import head, parser, row

from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.solvers import SOLVERS

ORDER, PART = 4, 5_000_000


def planted(seed: int, n: int, count: int, share: float) -> tuple[AffinityTensor, NDArray[np.int64]]:
    """A tensor of ``count`` hyper-edges of n points and n detections, made in parts, and the true assignment (n,)."""
    rng = np.random.default_rng(seed)
    truth = rng.permutation(n)
    points = np.array(list(combinations(range(n), ORDER)), np.int32)
    true = rng.permutation(points)[: int(share * min(len(points), count))]
    indices, weights = np.empty((count, ORDER), np.int32), np.empty(count)
    indices[: len(true)] = true * n + truth[true]
    weights[: len(true)] = np.exp(-0.5 * rng.chisquare(2, len(true)))
    for first in range(len(true), count, PART):
        size = min(PART, count - first)
        some = points[rng.integers(0, len(points), size)]
        # steps of less than a quarter of n: four different detections
        steps = np.concatenate([rng.integers(0, n, (size, 1)), rng.integers(1, n // ORDER, (size, ORDER - 1))], axis=1)
        indices[first : first + size] = some * n + np.cumsum(steps, axis=1) % n
        weights[first : first + size] = np.exp(-0.5 * rng.uniform(0.0, 12.0, size))
    return AffinityTensor.unchecked(indices, weights, (n, n), None), truth


def main() -> None:
    ask = parser(__doc__, points=60)
    ask.add_argument("--hyperedges", type=float, nargs="+", default=[1e6, 1e7])
    ask.add_argument("--solvers", nargs="+", choices=list(SOLVERS), default=["ascent", "power-l1", "rrwhm"])
    ask.add_argument("--share", type=float, default=1.0)
    given = ask.parse_args()
    for name in given.solvers:  # compiles
        SOLVERS[name](planted(0, given.points, 20_000, given.share)[0])
    head("hyper-edges", "solver", "seconds", "right", "score over that of the truth", "GB so far")
    for count in given.hyperedges:
        tensor, truth = planted(7, given.points, int(count), given.share)
        for name in given.solvers:
            started = perf_counter()
            assignment = SOLVERS[name](tensor).assignment
            seconds = perf_counter() - started
            score = tensor.score(assignment) / tensor.score(truth)
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
            right = f"{np.sum(assignment == truth)} of {given.points}"
            row(f"{count:.0e}", name, f"{seconds:.2f}", right, f"{score:.3f}", f"{memory:.1f}")


if __name__ == "__main__":
    main()

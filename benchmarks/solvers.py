"""Contraction beside ``np.add.at``, and what the discrete ascent takes on planted tensors.

A planted tensor holds every hyper-edge of a true assignment, with weights exp(−χ²/2) as noise leaves them, among
random false ones. Ratios are of one run on one machine. ``--json`` prints one object; ``--large`` adds five million
hyper-edges of order 4 (about 2 GB of memory while they are made).
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import time
from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from rootmatch.solvers import SOLVERS, MultiStartAscent
from rootmatch.solvers.subset_index import build_index
from rootmatch.tensor import AffinityTensor


def seconds(work: Callable[[], object], repeats: int) -> float:
    """Median time of a call, after one that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def random_pairs(rng: np.random.Generator, n: int, n_target: int, order: int, count: int) -> NDArray[np.int32]:
    """Random hyper-edges as flat indices, in blocks to bound the memory of the shuffles."""
    blocks = []
    for first in range(0, count, 500_000):
        size = min(500_000, count - first)
        source = np.argsort(rng.random((size, n)), axis=1)[:, :order]
        target = np.argsort(rng.random((size, n_target)), axis=1)[:, :order]
        blocks.append((source * n_target + target).astype(np.int32))
    return np.concatenate(blocks)


def planted(seed: int, n: int, n_target: int, order: int, count: int) -> tuple[AffinityTensor, NDArray[np.int64]]:
    """Tensor of `count` hyper-edges, those of the true assignment (n,) among them."""
    rng = np.random.default_rng(seed)
    truth = rng.permutation(n_target)[:n]
    source = np.array(list(itertools.combinations(range(n), order)))
    true = (source * n_target + truth[source]).astype(np.int32)
    false = random_pairs(rng, n, n_target, order, count - len(true))
    weights = np.exp(-np.concatenate([rng.chisquare(2, len(true)), rng.uniform(0, 12, len(false))]) / 2)
    mixed = rng.permutation(count)
    return AffinityTensor(np.concatenate([true, false])[mixed], weights[mixed], (n, n_target)), truth


def add_at(tensor: AffinityTensor, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """The contraction as one would write it in NumPy."""
    v, values = np.zeros(x.size), x.ravel()[tensor.indices]
    for p in range(tensor.order):
        np.add.at(v, tensor.indices[:, p], tensor.weights * np.delete(values, p, axis=1).prod(axis=1))
    return v.reshape(x.shape)


def contraction(repeats: int) -> dict[str, float]:
    """A million hyper-edges of order 3, n = n' = 20."""
    tensor, _ = planted(0, 20, 20, 3, 1_000_000)
    x = np.random.default_rng(0).random(tensor.shape)
    np.testing.assert_allclose(tensor.contract(x), add_at(tensor, x), rtol=1e-9)
    threads = numba.get_num_threads()
    all_threads = seconds(lambda: tensor.contract(x), repeats)
    numba.set_num_threads(1)
    one_thread = seconds(lambda: tensor.contract(x), repeats)
    numba.set_num_threads(threads)
    numpy = seconds(lambda: add_at(tensor, x), repeats)
    return {
        "milliseconds_one_thread": 1e3 * one_thread,
        "milliseconds": 1e3 * all_threads,
        "milliseconds_add_at": 1e3 * numpy,
        "ratio_one_thread": numpy / one_thread,
        "ratio": numpy / all_threads,
    }


def ascent(n: int, n_target: int, order: int, count: int, repeats: int) -> dict[str, float]:
    """Index and multi-start ascent, with its stopping rule and with all of its starts."""
    tensor, truth = planted(0, n, n_target, order, count)
    solver, patient = MultiStartAscent(), MultiStartAscent(agreement=10**9)
    solution = solver(tensor)
    return {
        "hyperedges": float(tensor.size),
        "milliseconds_index": 1e3 * seconds(lambda: build_index(tensor), repeats),
        "milliseconds": 1e3 * seconds(lambda: solver(tensor), repeats),
        "milliseconds_all_starts": 1e3 * seconds(lambda: patient(tensor), repeats),
        "accuracy": float(np.mean(solution.assignment == truth)),
        "margin": solution.margin,
    }


def all_solvers(repeats: int) -> dict[str, dict[str, float]]:
    """Each solver on 0.8 million nonzeros of the symmetric tensor of order 3, n = n' = 20, on one thread."""
    tensor, truth = planted(1, 20, 20, 3, 800_000 // math.factorial(3))
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    found = {}
    for name, solver in SOLVERS.items():
        solution = solver(tensor)
        found[name] = {
            "milliseconds": 1e3 * seconds(lambda solver=solver: solver(tensor), repeats),  # type: ignore[misc]
            "accuracy": float(np.mean(solution.assignment == truth)),
            "iterations": float(solution.iterations),
        }
    numba.set_num_threads(threads)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--large", action="store_true", help="five million hyper-edges of order 4 as well")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()

    result: dict[str, object] = {
        "threads": numba.get_num_threads(),
        "contraction, 1 M hyper-edges of order 3, n = 20": contraction(arguments.repeats),
        "ascent, 5 against 8, order 4": ascent(5, 8, 4, 300, arguments.repeats),
        "ascent, 10 against 10, order 4": ascent(10, 10, 4, 100_000, arguments.repeats),
        "ascent, 20 against 40, order 4": ascent(20, 40, 4, 500_000, arguments.repeats),
    }
    if arguments.large:
        result["ascent, 20 against 40, order 4, 5 M"] = ascent(20, 40, 4, 5_000_000, 1)
    for name, figures in all_solvers(arguments.repeats).items():
        result[f"{name}, 0.8 M symmetric nonzeros, n = 20, one thread"] = figures
    if arguments.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        if isinstance(value, dict):
            print(name)
            for key, figure in value.items():
                print(f"    {key:28s} {figure:12.4g}")
        else:
            print(f"{name}: {value}")


if __name__ == "__main__":
    main()

"""Contraction against ``np.add.at``, and time and accuracy of the solvers on planted tensors.

A planted tensor holds every hyper-edge of a true assignment, with weights exp(−χ²/2) as under noise, among
random false ones. Ratios are from one run on one machine. ``--json`` prints one object; ``--large`` adds five million
hyper-edges of order 4 (about 2 GB of memory while they are generated).
"""

from __future__ import annotations

import argparse
import json
import math

import numba
import numpy as np

from rootmatch.jit.threads import use_one_thread
from rootmatch.research.speed.contraction import measure_contraction, planted_tensor
from rootmatch.research.speed.timing import seconds
from rootmatch.solvers import SOLVERS, MultiStartAscent
from rootmatch.solvers.ascent.subset_index import build_index


def ascent(n: int, n_target: int, order: int, count: int, repeats: int) -> dict[str, float]:
    """Index and multi-start ascent, with its stopping rule and with all of its starts."""
    tensor, truth = planted_tensor(0, n, n_target, order, count)
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
    tensor, truth = planted_tensor(1, 20, 20, 3, 800_000 // math.factorial(3))
    found = {}
    with use_one_thread():
        for name, solver in SOLVERS.items():
            solution = solver(tensor)
            found[name] = {
                "milliseconds": 1e3 * seconds(lambda solver=solver: solver(tensor), repeats),  # type: ignore[misc]
                "accuracy": float(np.mean(solution.assignment == truth)),
                "iterations": float(solution.iterations),
            }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--large", action="store_true", help="five million hyper-edges of order 4 as well")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()

    result: dict[str, object] = {
        "threads": numba.get_num_threads(),
        "contraction, 1 M hyper-edges of order 3, n = 20": measure_contraction(1_000_000, 20, arguments.repeats),
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

"""Results of the CUDA backend on the cases of cuda_cases.py, into a file.

Run by test_cuda.py in a process of its own, where Numba's simulator stands in for a card: kernels and drivers are
interpreted there, so this is an evaluation of the same formulas that owes nothing to the compiler. Run by
benchmarks/gpu.py on a card.
"""

from __future__ import annotations

import sys
from threading import Thread
from typing import Any

import numpy as np

import rootmatch as rm
from cuda_cases import CASES, LIMITED, SINGLE, SOLVED, case_tables, given_hyperedges, random_tensor
from rootmatch.backends import cpu, cuda, cuda_float32, selection
from rootmatch.backends.cuda_contraction import DeviceTensor
from rootmatch.backends.strongest import Enumeration
from rootmatch.hypergraph.affinity import affinity
from rootmatch.jit.cuda import SIMULATED
from rootmatch.samplers.exhaustive import exhaustive_tensor
from rootmatch.samplers.random import random_tensor as sampled_tensor
from rootmatch.simulation import up2p_scene
from rootmatch.solvers import PowerIteration


def results() -> dict[str, Any]:
    made: dict[str, Any] = {}
    for name, case in CASES.items():
        tables = case_tables(case)
        kind = case.kind(case.pairs)
        ((_, made[f"{name} given"]),) = cuda.evaluated(tables, kind, [given_hyperedges(case)])
        work = Enumeration.of(tables, kind, case.shape, case.order, case.mask())
        found = cuda.strongest(work, *case.ranks(work), case.gate, case.limit)
        made[f"{name} codes"], made[f"{name} residuals"] = found.codes, found.residuals
        made[f"{name} evaluated"] = found.evaluated
    for name, case in SINGLE.items():
        work = Enumeration.of(case_tables(case), case.kind(case.pairs), case.shape, case.order, case.mask())
        found = cuda_float32.strongest(work, *case.ranks(work), case.gate, case.limit)
        made[f"{name} screened codes"], made[f"{name} screened residuals"] = found.codes, found.residuals
        made[f"{name} screened evaluated"] = found.evaluated
    for name, (case, limit) in LIMITED.items():
        cuda.LAUNCH, cuda.CAPACITY = 200, 8
        weigh = affinity("joint", gate=case.gate)
        kind = case.kind(case.pairs)
        tensor, evaluated = exhaustive_tensor(
            case_tables(case), kind, weigh, case.shape, case.order, max_hyperedges=limit, backend=cuda
        )
        made[f"{name} indices"], made[f"{name} weights"] = tensor.indices, tensor.weights
        made[f"{name} evaluated"] = evaluated
        drawn, _ = sampled_tensor(case_tables(case), kind, weigh, case.shape, case.order, 150, 3, backend=cuda)
        made[f"{name} drawn indices"], made[f"{name} drawn weights"] = drawn.indices, drawn.weights
    for order in (2, 3, 4, 5):
        tensor, x = random_tensor(order)
        made[f"contraction {order}"] = DeviceTensor.of(tensor).contract(x)
    tensor, _ = random_tensor(3)
    made["power"] = PowerIteration(iterations=2)(DeviceTensor.of(tensor)).soft
    scene = up2p_scene(**SOLVED)
    for backend in ("cuda", "cuda-float32"):
        match = rm.match(scene.source, scene.target, scene.problem, noise=scene.noise, backend=backend)
        made[f"{backend} assignment"], made[f"{backend} indices"] = match.assignment, match.tensor.indices
        made[f"{backend} weights"], made[f"{backend} evaluated"] = match.tensor.weights, match.evaluated
    made["auto is the processor"] = selection.choose_backend("auto", 1e12) is cpu
    return made


def wait_for_threads() -> None:
    """Let the simulator wait a moment for each thread that it asks: it asks in a loop, which takes half of the time."""
    from numba.cuda.simulator.kernel import BlockThread

    def alive(thread: Thread) -> bool:
        thread.join(0.001)
        return Thread.is_alive(thread)

    BlockThread.is_alive = alive


if __name__ == "__main__":
    if SIMULATED:
        wait_for_threads()
    with np.errstate(all="ignore"):
        np.savez(sys.argv[1], **results())

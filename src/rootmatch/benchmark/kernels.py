"""Hyper-edges a second of an exhaustive sweep, and factorisations a second of the matrices that it does without."""

from __future__ import annotations

import numpy as np

from rootmatch.affinity import NOISE_KINDS, Residual, affinity, exhaustive_tensor
from rootmatch.benchmark.scenes import prepared
from rootmatch.benchmark.timing import seconds

NARROW = 0.3
"""Gate in units of the noise: kernels and screening are timed, not the selection of what passes."""
KEPT = 100_000


def factorisations_per_second(degree: int, batch: int, repeats: int) -> float:
    """Batched ``numpy.linalg.qr`` of the Sylvester matrices of random unit polynomials."""
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, batch, degree + 1))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    matrices = np.zeros((batch, 2 * degree, 2 * degree))
    for row in range(degree):
        matrices[:, row, row : row + degree + 1] = first
        matrices[:, degree + row, row : row + degree + 1] = second
    return batch / seconds(lambda: np.linalg.qr(matrices, mode="r"), repeats)


def hyperedges_per_second(problem: str, kind: str, points: int, outliers: int, repeats: int) -> tuple[float, int]:
    """Rate of an exhaustive sweep, selection included, and how many hyper-edges it looks at."""
    scene, tables = prepared(problem, points, outliers)
    weigh = affinity(Residual(kind), gate=NARROW if kind in NOISE_KINDS else 1e-3 * scene.problem.paper_rho)
    shape = (len(scene.source), len(scene.target))
    residual = weigh.residual.kernel_kind(scene.problem.pair_count)
    evaluated = 0

    def sweep() -> None:
        nonlocal evaluated
        _, evaluated = exhaustive_tensor(tables, residual, weigh, shape, scene.problem.order, max_hyperedges=KEPT)

    spent = seconds(sweep, repeats)
    return evaluated / spent, evaluated

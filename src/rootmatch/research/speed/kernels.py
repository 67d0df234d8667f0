"""Hyper-edges per second of an exhaustive sweep, and QR factorisations per second of the matrices that it avoids."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.algebra.sylvester import sylvester_matrix
from rootmatch.hypergraph.affinity import NOISE_KINDS, Residual, affinity
from rootmatch.research.speed.scenes import scene_and_tables
from rootmatch.research.speed.timing import min_seconds
from rootmatch.samplers.exhaustive import exhaustive_tensor

NARROW = 0.3
"""Gate in units of the noise: narrow, to time kernels and screening rather than the selection of survivors."""
KEPT = 100_000


class Rate(NamedTuple):
    """Throughput of a kernel, and of the factorisations that it avoids."""

    hyperedges: int
    per_second: float
    qr_per_second: float


def sylvester_matrices(degree: int, batch: int) -> NDArray[np.float64]:
    """Sylvester matrices (batch, 2 k, 2 k) of random polynomials of degree k and unit norm."""
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, batch, degree + 1))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    return sylvester_matrix(first, second)


def rates(problem: str, kinds: Sequence[str], points: int, outliers: int, batch: int, repeats: int) -> list[Rate]:
    """Rates of exhaustive sweeps, selection included, of each kind alternating with batched ``numpy.linalg.qr``."""
    scene, tables = scene_and_tables(problem, points, outliers)
    matrices = sylvester_matrices(scene.problem.degree, batch)
    shape = (len(scene.source), len(scene.target))
    evaluated = {}

    def sweep(kind: str) -> None:
        weighting = affinity(Residual(kind), gate=NARROW if kind in NOISE_KINDS else 1e-3 * scene.problem.paper_rho)
        residual = weighting.residual.kernel_kind(scene.problem.pair_count)
        _, evaluated[kind] = exhaustive_tensor(
            tables, residual, weighting, shape, scene.problem.order, max_hyperedges=KEPT
        )

    works: list[Callable[[], object]] = [lambda: np.linalg.qr(matrices, mode="r"), *(partial(sweep, k) for k in kinds)]
    reference, *spent = min_seconds(works, repeats)
    return [
        Rate(evaluated[kind], evaluated[kind] / each, batch / reference)
        for kind, each in zip(kinds, spent, strict=True)
    ]

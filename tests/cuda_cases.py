"""What test_cuda.py evaluates twice, compiled for the processor and on a card or its simulator: small, and the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends.strongest import Enumeration
from rootmatch.cameras.pinhole import Camera
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems.planar_motion.problem import PlanarMotion
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth
from rootmatch.problems.similarity.problem import Rigid
from rootmatch.simulation import p3p_scene, three_plus_one_scene, up2p_scene

SCENES: dict[str, Any] = {"p3p": p3p_scene, "up2p": up2p_scene, "3p1": three_plus_one_scene}
KINDS = (QR, QRBoth, SVD, Normalised, Joint)
ALL = 1e300
SOLVED: dict[str, Any] = {"n": 5, "outliers": 1, "noise": 0.5, "seed": 2}
"""The scene of the whole match."""


@dataclass(frozen=True)
class Case:
    """One problem with one kind of residual."""

    problem: str
    kind: type
    pairs: int = 1
    shape: tuple[int, int] = (5, 6)
    share: float = 1.0
    gate: float = ALL
    limit: int = 10**6
    slabs: int = 8

    @property
    def order(self) -> int:
        return 4 if self.problem in ("p3p", "3p1") else 3

    def mask(self) -> NDArray[np.bool_] | None:
        return None if self.share == 1.0 else np.random.default_rng(5).random(self.shape) < self.share

    def ranks(self, work: Enumeration) -> tuple[int, int]:
        """Slabs from the middle: of two minimal sets of source points."""
        middle = len(work.arrangements)
        return max(0, middle - self.slabs // 2), min(work.ranks, middle + self.slabs // 2)


def case_scene(case: Case) -> tuple[Any, NDArray[np.int64]]:
    """Tables of a noisy scene with clutter, and which target point each source point is."""
    n, n_target = case.shape
    truth = np.arange(n)
    if case.problem in SCENES:
        scene = SCENES[case.problem](n=n, outliers=n_target - n, noise=0.5, seed=7)
        assert (len(scene.source), len(scene.target)) == case.shape
        return scene.problem.prepare(scene.source, scene.target, 0.5), scene.truth
    rng = np.random.default_rng(11)
    if case.problem == "rigid":
        source = rng.uniform(-1.0, 1.0, (n_target, 2))
        return Rigid().prepare(source[:n], source + 0.05 * rng.normal(size=source.shape), 0.05), truth
    camera = Camera(800.0, 800.0, 320.0, 240.0)
    points = rng.uniform((-2.0, -1.5, 4.0), (2.0, 1.5, 8.0), (n_target, 3))
    c, s = np.cos(0.3), np.sin(0.3)
    moved = points @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) + (1.0, 0.0, 0.5)
    first, second = (camera.project(view) + 0.5 * rng.normal(size=(n_target, 2)) for view in (points, moved))
    return PlanarMotion(camera, camera, axis=(0, 1, 0)).prepare(first[:n], second, 0.5), truth


def case_tables(case: Case) -> Any:
    return case_scene(case)[0]


def given_hyperedges(case: Case) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Hyper-edges as for `residuals`: random ones, and true ones in random order."""
    rng = np.random.default_rng(1)
    source, target = (np.array([rng.permutation(m)[: case.order] for _ in range(25)]) for m in case.shape)
    target[::2] = case_scene(case)[1][source[::2]]
    return source, target


CASES = {
    f"{problem} {kind.__name__} {pairs}": Case(problem, kind, pairs)
    for problem in SCENES
    for kind in KINDS
    for pairs in (1, 0b110)
}
CASES |= {f"rigid {kind.__name__}": Case("rigid", kind) for kind in (QR, Normalised, Joint)}
CASES |= {f"planar {kind.__name__}": Case("planar", kind) for kind in (QR, Joint)}
CASES |= {
    "candidates": Case("p3p", Joint, share=0.8, slabs=60),
    "gate": Case("up2p", Joint, gate=6.0, slabs=250),
    "strongest": Case("up2p", Normalised, limit=40, slabs=50),
}
SINGLE = {
    f"{problem} {kind.__name__} {pairs}": Case(problem, kind, pairs, shape=(6, 7), gate=40.0, slabs=80)
    for problem in ("p3p", "up2p")
    for kind in (Normalised, Joint)
    for pairs in (1, 0b110)
}
"""What there are kernels of single precision for."""
LIMITED = {
    "few of many": (Case("up2p", Joint), 50),
    "all": (Case("up2p", Joint, gate=20.0, shape=(4, 5)), 10**6),
}
"""Whole tensors, of which so many hyper-edges are kept."""


def random_tensor(order: int) -> tuple[AffinityTensor, NDArray[np.float64]]:
    """Tensor of random hyper-edges, and what to contract it with."""
    rng = np.random.default_rng(order)
    n, n_target = 5, 6
    rows = [np.array([rng.permutation(n)[:order] * n_target + rng.permutation(n_target)[:order] for _ in range(100)])]
    tensor = AffinityTensor(np.concatenate(rows), rng.random(100), (n, n_target), rng.random((n, n_target)))
    return tensor, rng.random((n, n_target))

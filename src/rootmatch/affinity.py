"""From residuals to a tensor of affinities: blocks of hyper-edges through a backend, the strongest kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch import hyperedges
from rootmatch.backends import cpu
from rootmatch.backends.selection import Backend, Block, Enumeration
from rootmatch.backends.selection import Progress as Progress
from rootmatch.errors import InputError
from rootmatch.kernels import kinds
from rootmatch.kernels.rows import sorted_rows
from rootmatch.tensor import AffinityTensor

KINDS: dict[str, type[kinds.Kind]] = {
    "qr": kinds.QR,
    "qr-both": kinds.QRBoth,
    "svd": kinds.SVD,
    "normalised": kinds.Normalised,
    "joint": kinds.Joint,
}
NOISE_KINDS = ("normalised", "joint")
"""Kinds in units of the noise; the others are in units of the polynomials."""


@dataclass(frozen=True)
class Residual:
    """How well the correspondences of a hyper-edge agree.

    Parameters
    ----------
    kind : str
        ``"qr"``: |R₂ₙ,₂ₙ| of the Sylvester matrix (paper); ``"qr-both"``: the lesser over x and 1/x; ``"svd"``: its
        least singular value; ``"normalised"``: one resultant in units of its standard deviation; ``"joint"``: √χ² of
        all constraints.
    pairs : tuple of int
        Which pairs of minimal sets are compared (P3P: 0–5, the shared two of four points; up2p: 0–2; 3P1: 0–5);
        several: the greatest of their residuals. The paper uses one. ``"joint"`` has no such choice.
    """

    kind: str = "joint"
    pairs: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"residual: {self.kind!r} given; one of {', '.join(KINDS)} expected")
        if not self.pairs or any(not 0 <= pair < 6 for pair in self.pairs):
            raise InputError(f"residual: pairs {self.pairs} given; give one or more of 0 to 5")

    def kernel_kind(self, pair_count: int) -> kinds.Kind:
        """The type that chooses the kernel."""
        if max(self.pairs) >= pair_count:
            raise InputError(f"residual: pair {max(self.pairs)} given; this problem has pairs 0 to {pair_count - 1}")
        return KINDS[self.kind](pairs=sum(1 << pair for pair in set(self.pairs)))


@dataclass(frozen=True)
class Affinity:
    """From residual r to weight.

    exp(−r / ρ) for the residuals of the paper (its equation 5), exp(−r² / 2ρ²) for those in units of the noise, where
    ρ = 1 is the likelihood of the residual.

    Parameters
    ----------
    residual : Residual
    rho : float
        Spread ρ.
    gate : float
        Residual above which a hyper-edge is dropped; its weight there is negligible.
    """

    residual: Residual
    rho: float
    gate: float

    def weights(self, residuals: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weights (E,) of residuals (E,)."""
        ratio = residuals / self.rho
        weights: NDArray[np.float64] = np.exp(-0.5 * ratio * ratio if self.residual.kind in NOISE_KINDS else -ratio)
        return weights


def affinity(residual: Residual | str = "joint", rho: float | None = None, gate: float | None = None) -> Affinity:
    """Affinity with the defaults of its kind of residual: ρ = 1 and a gate of 3.5 in units of the noise, else ρ = 0.01.

    Raises
    ------
    InputError
        If ρ or the gate is not positive.
    """
    chosen = residual if isinstance(residual, Residual) else Residual(residual)
    in_noise = chosen.kind in NOISE_KINDS
    spread = (1.0 if in_noise else 1e-2) if rho is None else float(rho)
    if not (np.isfinite(spread) and spread > 0.0):
        raise InputError(f"rho: {rho} given; give a positive number")
    # beyond 28 ρ a weight is below 1e-12 and changes nothing
    limit = (3.5 * spread if in_noise else 28.0 * spread) if gate is None else float(gate)
    if not limit > 0.0:
        raise InputError(f"gate: {gate} given; give a positive residual")
    # entries of a row that are no hyper-edge are infinite: a gate stays below that
    return Affinity(chosen, spread, min(limit, 1e300))


def exhaustive_residuals(
    tables: Any,
    kind: kinds.Kind,
    gate: float,
    shape: tuple[int, int],
    order: int,
    *,
    max_hyperedges: int = 5_000_000,
    candidates: NDArray[np.bool_] | None = None,
    backend: Backend = cpu,
    progress: Progress | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.float64], int]:
    """All hyper-edges whose residual is below the gate, at most ``max_hyperedges`` of them, the strongest.

    Parameters
    ----------
    tables
        Of `Problem.prepare`; the source points in an order that begins with points far apart is best.
    kind : Kind
    gate : float
        Residual above which a hyper-edge is dropped.
    shape : (n, n')
    order : int
    max_hyperedges : int
        Bounds the memory: 24 bytes each at order 4, 40 for a moment.
    candidates : (n, n') bool array, optional
        Correspondences that are possible; others are never evaluated.
    backend : Backend
        What evaluates.
    progress : callable, optional
        Called with (slabs done, slabs in all).

    Returns
    -------
    indices : (E, d) int32 array
        Flat correspondences, increasing in the source points.
    residuals : (E,) array
    evaluated : int
        How many hyper-edges were looked at.
    """
    work = Enumeration.of(tables, kind, shape, order, candidates)
    found = backend.strongest(work, 0, work.ranks, gate, max_hyperedges, progress)
    indices = cpu.decode(found.codes, work.bases, work.arrangements, shape[1], shape[0])
    return indices, found.residuals, found.evaluated


def exhaustive_tensor(
    tables: Any,
    kind: kinds.Kind,
    weigh: Affinity,
    shape: tuple[int, int],
    order: int,
    *,
    max_hyperedges: int = 5_000_000,
    candidates: NDArray[np.bool_] | None = None,
    backend: Backend = cpu,
    progress: Progress | None = None,
) -> tuple[AffinityTensor, int]:
    """Tensor of `exhaustive_residuals`, and how many hyper-edges were looked at."""
    indices, residuals, evaluated = exhaustive_residuals(
        tables, kind, weigh.gate, shape, order,
        max_hyperedges=max_hyperedges, candidates=candidates, backend=backend, progress=progress,
    )  # fmt: skip
    return AffinityTensor.unchecked(indices, weigh.weights(residuals), shape), evaluated


def given_tensor(
    tables: Any,
    kind: kinds.Kind,
    weigh: Affinity,
    shape: tuple[int, int],
    source: NDArray[np.int64],
    target: NDArray[np.int64],
) -> AffinityTensor:
    """Tensor of those of the given hyper-edges (E, d), (E, d) whose residual is below the gate, in their order."""
    residuals = cpu.residuals(tables, kind, source, target)
    keep = residuals <= weigh.gate
    indices = (source[keep] * shape[1] + target[keep]).astype(np.int32)
    return AffinityTensor.unchecked(indices, weigh.weights(residuals[keep]), shape)


def random_tensor(
    tables: Any,
    kind: kinds.Kind,
    weigh: Affinity,
    shape: tuple[int, int],
    order: int,
    samples: int,
    seed: int,
    *,
    candidates: NDArray[np.bool_] | None = None,
    backend: Backend = cpu,
    progress: Progress | None = None,
) -> tuple[AffinityTensor, int]:
    """Tensor H_s of the first ``samples`` hyper-edges of the random stream (paper, section "Overall Algorithm").

    A hyper-edge drawn twice is one entry of the tensor. A residual in units of the noise is worked out with the source
    points in increasing order, whatever the order that was drawn, as `exhaustive_residuals` does.
    """
    n, n_target = shape
    increasing = weigh.residual.kind in NOISE_KINDS
    stream = hyperedges.random_hyperedges(n, n_target, order, samples, seed, mask=candidates)

    def blocks() -> Iterator[Block]:
        for source, target in stream:
            if increasing:
                source, target = np.divmod(sorted_rows((source * n_target + target).astype(np.int32)), n_target)
            yield source, target

    parts: list[tuple[NDArray[np.int32], NDArray[np.float64]]] = []
    done = 0
    for (source, target), residuals in backend.evaluated(tables, kind, blocks()):
        keep = residuals <= weigh.gate
        parts.append(((source[keep] * n_target + target[keep]).astype(np.int32), residuals[keep]))
        done += len(source)
        if progress is not None:
            progress(done, samples)
    indices = np.ascontiguousarray(np.concatenate([part[0] for part in parts]))
    weights = weigh.weights(np.concatenate([part[1] for part in parts]))
    return AffinityTensor.unchecked(indices, weights, shape).merged(), done

"""From residuals to a tensor of affinities: blocks of hyper-edges through a backend, the strongest kept."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError
from rootmatch.problems import residual_kinds
from rootmatch.problems.limits import GATE

KINDS: dict[str, type[residual_kinds.Kind]] = {
    "qr": residual_kinds.QR,
    "qr-both": residual_kinds.QRBoth,
    "svd": residual_kinds.SVD,
    "normalised": residual_kinds.Normalised,
    "joint": residual_kinds.Joint,
}
NOISE_KINDS = ("normalised", "joint")
"""Kinds in units of the noise; the others are in units of the polynomials."""


@dataclass(frozen=True)
class Residual:
    """A measure of how well the correspondences of a hyper-edge agree.

    Parameters
    ----------
    kind : str
        ``"qr"``: ∣R₂ₙ,₂ₙ∣ of the Sylvester matrix (paper); ``"qr-both"``: the smaller one over x and 1/x; ``"svd"``:
        its smallest singular value; ``"normalised"``: one resultant in units of its standard deviation; ``"joint"``:
        √χ² of all constraints.
    pairs : tuple of int
        Which pairs of minimal sets are compared (P3P: 0–5, the shared two of four points; up2p: 0–2; 3P1: 0–5); with
        several, the largest of their residuals counts. The paper uses one. ``"joint"`` has no such choice.
    """

    kind: str = "joint"
    pairs: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"residual: {self.kind!r} given; one of {', '.join(KINDS)} expected")
        if not self.pairs or any(not 0 <= pair < 6 for pair in self.pairs):
            raise InputError(f"residual: pairs {self.pairs} given; give one or more of 0 to 5")

    def kernel_kind(self, pair_count: int, problem: str = "the problem") -> residual_kinds.Kind:
        """The type by which Numba selects the residual's kernel."""
        if max(self.pairs) >= pair_count:
            raise InputError(
                f"residual: {problem} has pairs 0 to {pair_count - 1} of minimal sets, pair {max(self.pairs)} given; "
                "give one or more of those"
            )
        return KINDS[self.kind](pairs=sum(1 << pair for pair in set(self.pairs)))


@dataclass(frozen=True)
class Affinity:
    """The map from the residual r of a hyper-edge to its weight.

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


@lru_cache(maxsize=64)
def affinity(residual: Residual | str = "joint", rho: float | None = None, gate: float | None = None) -> Affinity:
    """Affinity with the defaults of its kind of residual: ρ = 1 and `GATE` in units of the noise, else ρ = 0.01.

    Raises `InputError` if ρ or the gate is not positive.
    """
    chosen = residual if isinstance(residual, Residual) else Residual(residual)
    in_noise = chosen.kind in NOISE_KINDS
    spread = (1.0 if in_noise else 1e-2) if rho is None else float(rho)
    if not 0.0 < spread < math.inf:
        raise InputError(f"rho: {rho} given; give a positive number")
    # beyond 28 ρ a weight is below 1e-12 and changes nothing
    limit = (GATE * spread if in_noise else 28.0 * spread) if gate is None else float(gate)
    if not limit > 0.0:
        raise InputError(f"gate: {gate} given; give a positive residual")
    # entries of a row that are no hyper-edge are infinite: a gate stays below that
    return Affinity(chosen, spread, min(limit, 1e300))

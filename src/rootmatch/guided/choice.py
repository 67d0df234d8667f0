"""What chooses hyper-edges and weighs them, and what comes of it."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rootmatch.affinity import Affinity, Progress
from rootmatch.kernels import kinds
from rootmatch.tensor import AffinityTensor


class Weighed(NamedTuple):
    """What became of a choice of hyper-edges."""

    tensor: AffinityTensor
    """Of those chosen whose residual is below the gate."""
    evaluated: int
    """All evaluations that it took: for a search minimal sets solved, points looked up, predictions and hyper-edges."""
    share: float = 1.0
    """Part of the hyper-edges inside a right answer that was evaluated, 0 to 1."""
    chance: float | None = None
    """Mean weight of a random hyper-edge, where it is known."""
    found: bool = True
    """Whether a search ended because what it found stands out; if not, it spent its budget or tried all."""
    partial: bool = False
    """Whether only what was proposed was looked at, so that a small motion may be missing."""


class Choice(Protocol):
    """Something that chooses hyper-edges and weighs them."""

    def __call__(
        self,
        tables: Any,
        kind: kinds.Kind,
        weigh: Affinity,
        shape: tuple[int, int],
        order: int,
        *,
        seed: int = 0,
        motions: int | Literal["auto"] = 1,
        candidates: NDArray[np.bool_] | None = None,
        progress: Progress | None = None,
    ) -> Weighed:
        """Tensor of the hyper-edges of some order between n source and n' target points; see `Guided`."""
        ...

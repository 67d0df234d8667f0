"""What chooses hyper-edges and weighs them: what it is asked for, and what comes of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends.strongest import Progress
from rootmatch.hypergraph import enumeration
from rootmatch.hypergraph.affinity import Affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.problems import residual_kinds


@dataclass(frozen=True, eq=False)
class Request:
    """What a choice of hyper-edges is asked for: the points of a problem, and what may be matched with what."""

    tables: Any
    """Of `Problem.prepare`, which knows the noise; best with the source points in the order of `wide_first`."""
    kind: residual_kinds.Kind
    """Which residual weighs a hyper-edge; its type chooses the kernel."""
    weigh: Affinity
    """From that residual to a weight, and the gate beyond which a hyper-edge is dropped."""
    shape: tuple[int, int]
    """Source and target points, (n, n')."""
    order: int
    """Correspondences of a hyper-edge, d: one more than a minimal set has."""
    seed: int = 0
    """Of everything random."""
    motions: int | Literal["auto"] = 1
    """How many rigid motions are looked for; "auto" for any number of them."""
    candidates: NDArray[np.bool_] | None = None
    """(n, n') correspondences that are possible, others are never tried; None for all."""
    progress: Progress | None = None
    """Called now and then with (done, in all), in units of the choice's own."""

    @property
    def allowed(self) -> NDArray[np.bool_]:
        """The candidates as kernels take them: (n, n'), or (0, 0) where all are possible."""
        if self.candidates is None:
            return np.empty((0, 0), np.bool_)
        return np.ascontiguousarray(self.candidates, np.bool_)

    @property
    def count(self) -> float:
        """Hyper-edges that there are, about; exactly where all correspondences are possible."""
        return enumeration.estimated_count(*self.shape, self.order, self.candidates)


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
    """Something that chooses hyper-edges and weighs them, such as `Guided`; `match` takes any."""

    def __call__(self, request: Request) -> Weighed:
        """Tensor of the hyper-edges that it chooses and whose residual is below the gate."""
        ...

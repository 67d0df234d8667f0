"""Guided choice of hyper-edges: minimal sets propose where every point is seen, and what they propose is weighed.

Exhaustion looks at C(n, d) · n'!/(n' − d)! hyper-edges, of which all but C(n, d) are false. Here a few wide minimal
sets of source points are tried with every image they may have; each solution predicts where the other points are seen,
and a sequential test ends the false ones after a look or two (`rootmatch.kernels.propose`). The proposals that survive
name candidate correspondences, and the hyper-edges among those, no others, go through the ordinary residual into the
tensor. No pose is handed on: the minimal problem proposes, the residual weighs, the solver decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rootmatch import hyperedges
from rootmatch.affinity import Affinity, Progress, given_tensor
from rootmatch.backends import cpu
from rootmatch.errors import InputError
from rootmatch.guided.choice import Choice, Weighed
from rootmatch.guided.gather import hyperedges_among, random_hyperedges
from rootmatch.guided.search import Search
from rootmatch.kernels import (  # noqa: F401  (two of them register what they propose)
    kinds,
    p3p_propose,
    up2p_propose,
)
from rootmatch.kernels.proposers import can_propose

__all__ = ["Choice", "Guided", "Weighed", "can_propose", "pays"]

CHANCE_SAMPLES = 4096
"""Random hyper-edges that tell how well chance does."""
CHEAP, CHEAP_OF_MANY = 2_000_000, 200_000_000
"""Hyper-edges up to which looking at all of them takes no longer than a search for one motion, for several."""


def pays(
    tables: Any,
    shape: tuple[int, int],
    order: int,
    motions: int | Literal["auto"] = 1,
    candidates: NDArray[np.bool_] | None = None,
) -> bool:
    """Whether a guided search is possible and cheaper than to look at all hyper-edges."""
    count = hyperedges.estimated_count(*shape, order, candidates)
    return can_propose(type(tables)) and count > (CHEAP if motions == 1 else CHEAP_OF_MANY)


@dataclass(frozen=True)
class Guided:
    """Guided search, and how hard to search.

    Parameters
    ----------
    budget : int
        Most evaluations: minimal sets solved and points looked up. A search that finds something beyond chance ends
        long before; one that does not, ends here or when every minimal set was tried.
    max_seconds : float, optional
        Time after which no new batch begins. What is found then depends on the machine.
    groups : int
        Most groups of like proposals whose hyper-edges are evaluated.
    gate : float
        Distance from a prediction, in σ, within which a detection counts while minimal sets are tried.
    subsets : int
        Most d-subsets of source points whose hyper-edges are evaluated; a seeded choice where there are more.
    edges : int
        Most hyper-edges that are evaluated, those of the strongest groups.
    """

    budget: int = 500_000_000
    max_seconds: float | None = None
    groups: int = 1000
    gate: float = 8.0
    subsets: int = 20_000
    edges: int = 300_000

    def __post_init__(self) -> None:
        for name in ("budget", "groups", "gate", "subsets", "edges"):
            if not getattr(self, name) > 0:
                raise InputError(f"Guided: {name} is {getattr(self, name)!r}; give a positive number")

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
        """Tensor of the hyper-edges among the correspondences that minimal sets propose.

        Parameters
        ----------
        tables
            Of `Problem.prepare`; the source points in an order that begins with points far apart is best.
        kind : Kind
        weigh : Affinity
        shape : (n, n')
        order : int
        seed : int
            Of the order in which minimal sets are tried, and of the choice of hyper-edges where there are too many.
        motions : int or "auto"
            With 1 the search ends when one proposal is beyond chance; with more it goes on to the budget.
        candidates : (n, n') bool array, optional
            Correspondences that are possible; others are never tried.
        progress : callable, optional
            Called with (evaluations, budget) between batches.

        Raises
        ------
        InputError
            If the problem has no proposals.
        """
        if not can_propose(type(tables)):
            raise InputError('hyperedges: this problem has no proposals to be guided by; use "exhaustive" or "random"')
        search = Search(tables, shape, order - 1, seed, motions, self, candidates)
        search.run(progress)
        search.refine()
        source, target, share = hyperedges_among(search.settle(), shape, order, self, search.rng)
        tensor = given_tensor(tables, kind, weigh, shape, source, target)
        by_chance = cpu.residuals(tables, kind, *random_hyperedges(shape, order, CHANCE_SAMPLES, search.rng))
        # no sample is large enough to say that chance never agrees
        chance = max(1.0, float(weigh.weights(by_chance[by_chance <= weigh.gate]).sum())) / CHANCE_SAMPLES
        evaluated = search.evaluated + len(source) + CHANCE_SAMPLES
        return Weighed(tensor, evaluated, share, chance, search.found, partial=True)

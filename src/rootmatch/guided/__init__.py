"""Guided choice of hyper-edges: minimal sets propose where every point is seen, and what they propose is weighed.

Exhaustion looks at C(n, d) · n'!/(n' − d)! hyper-edges, of which all but C(n, d) are false. Here a few wide minimal
sets of source points are tried with every image they may have; each solution predicts where the other points are seen,
and a sequential test ends the false ones after a look or two (`rootmatch.kernels.propose`). The proposals that survive
name candidate correspondences, and the hyper-edges among those, no others, go through the ordinary residual into the
tensor. No pose is handed on: the minimal problem proposes, the residual weighs, the solver decides.
"""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.affinity import given_tensor
from rootmatch.backends import cpu
from rootmatch.errors import InputError
from rootmatch.guided.choice import Choice, Request, Weighed
from rootmatch.guided.gather import hyperedges_among, random_hyperedges
from rootmatch.guided.search import Search
from rootmatch.kernels import p3p_propose, up2p_propose  # noqa: F401  (they register what they propose)
from rootmatch.kernels.proposers import can_propose

__all__ = ["Choice", "Guided", "Request", "Weighed", "can_propose", "pays"]

CHANCE_SAMPLES = 4096
"""Random hyper-edges that tell how well chance does."""
CHEAP, CHEAP_OF_MANY = 2_000_000, 200_000_000
"""Hyper-edges up to which looking at all of them takes no longer than a search for one motion, for several."""


def pays(request: Request) -> bool:
    """Whether a guided search is possible and cheaper than to look at all hyper-edges."""
    return can_propose(type(request.tables)) and request.count > (CHEAP if request.motions == 1 else CHEAP_OF_MANY)


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

    def __call__(self, request: Request) -> Weighed:
        """Tensor of the hyper-edges among the correspondences that minimal sets propose.

        Parameters
        ----------
        request : Request
            Its seed is that of the order in which minimal sets are tried, and of the choice of hyper-edges where there
            are too many. With one motion the search ends when one proposal is beyond chance, with more when as many
            are. Progress is told between batches as (evaluations, budget).

        Raises
        ------
        InputError
            If the problem has no proposals.
        """
        tables, weigh = request.tables, request.weigh
        if not can_propose(type(tables)):
            raise InputError('hyperedges: this problem has no proposals to be guided by; use "exhaustive" or "random"')
        search = Search(request, self)
        search.run()
        search.refine()
        source, target, share = hyperedges_among(search.settle(), request.shape, request.order, self, search.rng)
        tensor = given_tensor(tables, request.kind, weigh, request.shape, source, target)
        drawn = random_hyperedges(request.shape, request.order, CHANCE_SAMPLES, search.rng)
        by_chance = cpu.residuals(tables, request.kind, *drawn)
        # no sample is large enough to say that chance never agrees
        chance = max(1.0, float(weigh.weights(by_chance[by_chance <= weigh.gate]).sum())) / CHANCE_SAMPLES
        evaluated = search.evaluated + len(source) + CHANCE_SAMPLES
        return Weighed(tensor, evaluated, share, chance, search.found, partial=True)

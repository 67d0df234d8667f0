"""Options of the guided search."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option
from rootmatch.samplers.guided.stopping import StoppingOptions

__all__ = ["GuidedOptions", "StoppingOptions"]


@dataclass(frozen=True)
class GuidedOptions(Options):
    """How hard the guided search looks for hypotheses.

    Parameters
    ----------
    budget : int
        Most evaluations: minimal sets solved and points looked up. A search that finds something beyond chance ends
        long before; one that does not, ends here or when every minimal set was tried. Half a minute of two cores.
    max_seconds : float, optional
        Time after which no new batch begins. What is found then depends on the machine.
    subsets : int
        Most d-subsets of source points whose hyper-edges are evaluated; a seeded selection of more: every point of a
        hundred is still in 150 to 200 of them. The accuracy with it: benchmarks/matches.py.
    edges : int
        Most hyper-edges that are evaluated, those of the strongest clusters.
    hypotheses : int
        Most assignments that are handed on beside the hyper-edges, to be fitted by a pose each.
    stopping : StoppingOptions
        When the search ends before its budget is spent.
    """

    budget: int = option(500_000_000, above=0)
    max_seconds: float | None = option(None, minimum=0.0)
    subsets: int = option(5_000, above=0)
    edges: int = option(300_000, above=0)
    hypotheses: int = option(200, minimum=1)
    stopping: StoppingOptions = option(StoppingOptions())

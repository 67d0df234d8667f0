"""Options of the guided search: how hard to search."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.errors import InputError


@dataclass(frozen=True)
class GuidedOptions:
    """How hard to search.

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

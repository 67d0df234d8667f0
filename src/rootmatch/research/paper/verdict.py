"""How a claim is judged: cases with a yes or no each, and the verdict that follows from them."""

from __future__ import annotations

from dataclasses import dataclass

FULL = 0.99
"""Mean accuracy that counts as "100 %": at most ten of the thousand points of a hundred instances are wrong."""
GOOD = 0.80
"""Mean accuracy that counts as "good", "robust" or "handled": four points of five, enough for any robust estimate. A
threshold of ours, like the next two: the paper has plots, which we could not see, and no numbers."""
RAPID = 0.30
"""Fall of the mean accuracy that counts as "rapid" between the noise-free case and the noise named in the rule."""
EQUAL = 0.05
"""Mean accuracies closer than this count as equal: half a point of ten."""
FEW = 100_000
"""Samples that count as "few": a tenth of the largest sample."""
LOST = 0.10
"""Mean accuracy up to which a method is at chance level: what guessing gives with ten image points. Two methods at
chance level cannot be compared."""


@dataclass(frozen=True)
class Case:
    """One instance of a claim."""

    name: str
    """What it is about, such as ``"P3P, σ = 0.1"``."""
    holds: bool | None
    """None if nothing that could have been measured would have decided otherwise."""
    figures: str
    """What decides it, or why nothing does."""


def verdict(cases: list[Case]) -> str:
    """Say ``holds``, ``does not hold``, ``holds only for …`` with the cases named, or ``undecidable``."""
    if not cases:
        raise ValueError("no case to judge")
    decided = [case for case in cases if case.holds is not None]
    if not decided:
        return "undecidable"
    true = [case.name for case in decided if case.holds]
    found = "holds only for " + "; ".join(true)
    if len(true) == len(decided):
        found = "holds"
    elif not true:
        found = "does not hold"
    undecided = [case.name for case in cases if case.holds is None]
    return f"{found} (undecidable for {'; '.join(undecided)})" if undecided else found

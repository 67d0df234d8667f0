"""Options of the search for several known bodies: budgets, rounds, and probabilities from which a body is certain."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option


@dataclass(frozen=True)
class BodyOptions(Options):
    """How several bodies are searched for; what it finds and costs: benchmarks/bodies.py."""

    first_budget: int = option(200_000, least=1)
    """Evaluations of the first search for each body with normals: enough for most bodies that show much. On tuning
    seeds it finds as many as 400,000 or 3,000,000 do, in less time."""
    first_budget_without_normals: int = option(600_000, least=1)
    """Evaluations of the first search if normals do not tell which points are visible together."""
    budget_growth: float = option(3.0, above=1.0)
    """Factor from one round of searches to the next. A round value."""
    rounds: int = option(4, least=1)
    """Largest number of rounds in which the budget grows. A round value."""
    sure: float = option(0.98, above=0.0, most=1.0)
    """Probability from which a body takes its detections before the others are known."""
    confirmed: int = option(6, least=5)
    """Number of matches from which a certain body whose search was cut short is called matched if its detections allow
    no other pose. A round value; none on the tuning seeds was wrong."""
    alike: float = option(0.02, least=0.0)
    """Distance of their points, over their size, up to which two bodies are taken for one shape or for mirror images.
    A round value."""
    doubt: float = option(0.1, above=0.0, most=1.0)
    """Probability of another body at the same detections from which the first is in doubt: 1 −
    `TrustOptions.probability`."""


OPTIONS = BodyOptions()

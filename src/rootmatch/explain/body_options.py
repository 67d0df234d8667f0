"""How several known bodies are searched for: budgets, rounds and the probabilities from which a body is sure."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.options import Options, option


@dataclass(frozen=True)
class BodyOptions(Options):
    """How several bodies are searched for; what it finds and costs: benchmarks/bodies.py."""

    first_budget: int = option(200_000, least=1)
    """Evaluations of the first search for each body with normals: most that show much are found within. On development
    seeds as many are found as with 400,000 or 3,000,000, in less time."""
    first_budget_without_normals: int = option(600_000, least=1)
    """The same where normals do not tell which points are seen together."""
    budget_growth: float = option(3.0, above=1.0)
    """Factor from one round of searches to the next. A round value."""
    rounds: int = option(4, least=1)
    """Most rounds whose searches may grow. A round value."""
    sure: float = option(0.98, above=0.0, most=1.0)
    """Probability from which a body takes its detections before the others are known."""
    confirmed: int = option(6, least=5)
    """Matches from which a sure body whose search was cut short is matched where its detections allow no other pose. A
    round value; none on the development seeds was wrong."""
    alike: float = option(0.02, least=0.0)
    """Distance of their points, over their size, up to which two bodies are taken for one shape or for mirror images.
    A round value."""
    doubt: float = option(0.1, above=0.0, most=1.0)
    """Probability of another body at the same detections from which the first is in doubt: 1 less
    `TrustOptions.probability`."""


OPTIONS = BodyOptions()

"""Options of the search between two views."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rootmatch.options import Options, option


@dataclass(frozen=True)
class TwoViewOptions(Options):
    """How a relative pose is searched; accuracy and time are those of benchmarks/two_views.py."""

    first_wave: int = option(3, least=1)
    """Minimal sets of source points that are tried before the first look at what was found."""
    wave: int = option(2, least=1)
    """Minimal sets of each further look."""
    most_sets: int = option(64, least=1)
    """Most minimal sets of source points that are tried."""
    budget: int = option(4_000_000, least=1)
    """Most minimal sets with images that are solved."""
    agreeing: int = option(3, least=1)
    """Minimal sets that must have led to the likeliest assignment before the search ends."""
    same: float = option(0.7, above=0.0, most=1.0)
    """Share of matches that two assignments must have in common to be the same."""
    kept: int = option(64, least=1)
    """Poses of a minimal set that are kept."""
    refined: int = option(16, least=1)
    """The likeliest of them, which are refined on all points."""
    assignments: int = option(12, least=1)
    """Assignments that are handed on, to be fitted by a pose each."""
    clusters: int = option(4, least=1)
    """The likeliest of them whose hyper-edges are evaluated."""
    candidates: int = option(3, least=1)
    """Detections of a source point that take part in hyper-edges."""
    trust: float = option(0.25, least=0.0, most=1.0)
    """Factor on differences in evidence where hypotheses vote on correspondences. On the development seeds (b = 5,
    σ = 1, 20 + 20) 0.1, 0.25 and 0.5 have .94, .94 and .93 right."""
    least_share: float = option(0.15, least=0.0, most=1.0)
    """Expected share of a correspondence below which it is left out of what they agree on."""
    edges: int = option(60_000, least=1)
    """Most hyper-edges that are evaluated."""
    visible: float = option(0.8, above=0.0, most=0.99)
    """Probability that a source point is detected."""
    reject: float = option(-4.0)
    """Log-likelihood ratio at which the sequential test rejects a pose, …"""
    drift: float = option(0.3, least=0.0)
    """… less so much for each point that was looked at: among dense clutter a point of the right pose is worth less
    than nothing now and then. Of the true poses of 50 + 25 points (b = 5, σ = 1) nine tenths stay above both."""
    gate: float = option(6.0, above=0.0)
    """Deviation, in σ, within which the correspondences of a minimal set fit their own pose."""
    spread: float = option(6.0, above=1.0)
    """Largest ratio of the inverse distances of a minimal set: of one order of magnitude."""
    blur: float = option(1.5, least=0.0)
    """Deviation, in σ, that the error of a minimal set's pose adds."""
    breadth: float = option(math.pi / math.sqrt(48.0), above=0.0)
    """Standard deviation of the logarithm of the inverse distances: that of their log-logistic density."""

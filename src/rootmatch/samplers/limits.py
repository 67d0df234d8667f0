"""Limits of sampling: how many hyper-edges are evaluated exhaustively or at random, and when to search instead."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SamplingLimits:
    """Sizes in hyper-edges at which one way of sampling gives way to another: round figures of `benchmarks/matches.py`.

    Parameters
    ----------
    exhaustive, exhaustive_on_device : int
        Most that an exhaustive sweep evaluates unasked: about a minute on two cores, and on a card.
    affordable : int
        Up to here all are evaluated after a search that found nothing beyond chance: some seconds on two cores.
    random : int
        Most random hyper-edges drawn unasked: about half a minute on two cores.
    per_searched : int
        Such a search spends one evaluation for so many hyper-edges, about the time of the sweep: 35 ns an evaluation,
        22 ns a hyper-edge. With an eighth, 8 points of 30 were found in 11 of 20 scenes, with a half in 19, in a
        quarter of the time (`rootmatch benchmark blind`, three quarters unseen, seeds from 1000).
    swept : int
        Up to here a sweep takes no longer than the quickest search by poses of one motion: three to five milliseconds.
        From here to ``guided`` it follows where the match of such a search is not trusted.
    quick : int
        Evaluations that such a search may spend at least: about ten milliseconds.
    guided, guided_multi_motion : int
        Up to here an exhaustive sweep takes no longer than a search, for one motion and for several
        (docs/notebook/performance.md).
    cheap_on_device : int
        Up to here a card has evaluated all before a search has its first hypothesis.
    """

    exhaustive: int = 4_000_000_000
    exhaustive_on_device: int = 100_000_000_000
    affordable: int = 500_000_000
    random: int = 200_000_000
    per_searched: int = 2
    swept: int = 100_000
    quick: int = 100_000
    guided: int = 2_000_000
    guided_multi_motion: int = 200_000_000
    cheap_on_device: int = 1_000_000_000


LIMITS = SamplingLimits()

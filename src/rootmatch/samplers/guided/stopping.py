"""Where the guided search stops: when a hypothesis is beyond chance, and when no better one is to be expected."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rootmatch.arrays import Bools, Floats, median
from rootmatch.options import Options, option

if TYPE_CHECKING:
    from rootmatch.samplers.guided.search import Search


@dataclass(frozen=True)
class StoppingOptions(Options):
    """When a search ends before its budget is spent; what it finds by then is in benchmarks/guided.py."""

    beyond_chance: float = option(7.0, above=0.0)
    """Evidence above the logarithm of the number of tests from which a hypothesis is no false alarm: 7 is one false
    alarm in a thousand searches. By construction."""
    complete: float = option(0.9, above=0.0, maximum=1.0)
    """Fraction of the points that can be matched from which the hypotheses are complete and the search ends."""
    in_part: bool = option(False)
    """Whether other images tell which hypotheses are right, as those of a rig's other cameras: then what chance
    explains as well ends no search, however much it explains."""


TRUSTED = math.log(19.0)
"""Log-odds from which a match is trusted: a probability of .95."""
OVERLAP = 0.5
"""Fraction of its points that a hypothesis may share with stronger ones and still count as another motion."""


def false_alarm_level(tested: int, options: StoppingOptions) -> float:
    """Evidence that chance reaches once in a thousand searches with so many tested hypotheses."""
    return math.log(max(tested, 1)) + options.beyond_chance


def min_telling_matches(density: Floats, variance: Floats, minimal: int, sets: float) -> int:
    """Fewest matches of a pose that is not expected among so many minimal sets by chance.

    A match beyond a minimal set is worth at most what it is exactly where it is predicted, of the detection in the
    middle; see `verification.verify`. Fewer are neither trusted nor named with reason.

    Parameters
    ----------
    density, variance : (n',) array
        Of all detections about each, and of its bearing.
    minimal : int
        Matches of a minimal set.
    sets : float
        Number of sets with all their images.
    """
    worth = -math.log(2.0 * math.pi * median(variance * density))
    return minimal + math.ceil((math.log(sets) + TRUSTED) / worth) if worth > 0.0 else len(density)


def has_found_enough(search: Search) -> bool:
    """Whether as many hypotheses as there are motions are beyond chance, and stronger ones would have been met."""
    leaders, _, hypotheses = search._cluster_hypotheses()
    complete = search.options.stopping.complete * min(search.shape)
    if search.single and (hypotheses.best[0] >= 0).sum() >= complete:
        return True
    covered: Bools = np.zeros(search.n, np.bool_)
    sizes: list[int] = []
    for best in hypotheses.best[leaders[hypotheses.evidence[leaders] > search._false_alarm_level()]]:
        matched = best >= 0
        if (matched & covered).sum() <= OVERLAP * matched.sum():
            covered |= matched
            sizes.append(int(matched.sum()))
    if covered.sum() >= complete:
        return True
    # minimal sets that are solved, on average, until one of the smallest motion's is among them
    every = search.possible * math.perm(search.n_target, search.minimal)
    return len(sizes) >= search.motions and search.solved >= every * (search.n / min(sizes)) ** search.minimal

"""Growth of local hypotheses: verified on the points near their triple, then on ever more about it.

A small triple of a large object predicts its neighbours well and the far side hardly at all. Verified on the whole
object it would be judged by a thousand points that it knows nothing of, at their cost; among its nearest points it is
beyond chance at once. Wide triples of the matches found there reach farther, and so on until all are looked up.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.problems.padding import select_sources
from rootmatch.samplers.guided.hypotheses import Hypotheses
from rootmatch.samplers.guided.minimal_sets import at_every_root, widest_sets
from rootmatch.samplers.guided.verification import verify

VERIFIED = 64
"""Nearest points on which the hypotheses of a large object are verified first. Of 2,000 points in benchmarks/targets.py
true triples then have an evidence of 44 in the median, with 24 points 34, with 160 points 20, and with all hardly
any."""
STRIDE = 4.0
"""Factor on that number from one stage of growth to the next: twice as far."""
WIDE_SETS = 16
"""Triples of the matches found so far that are solved in each stage, wide ones."""


class Lead(NamedTuple):
    """A local hypothesis that is beyond chance among the points near its triple."""

    evidence: float
    points: Integers
    """(3,) points of the triple that it grew from."""
    images: Integers
    """(3,) detections of those points."""
    best: Integers
    """(n,) image of each source point, −1 for none or not looked up."""


class PartialVerification:
    """Verification of hypotheses on some of the source points.

    Parameters
    ----------
    tables
        Whose record names fields with a source axis.
    positions : (n, 3) array
        Source points.
    density : (n',) array
        Of detections about each.
    allowed : (n, n') bool array, or (0, 0) for all
    """

    def __init__(self, tables: Any, positions: Floats, density: Floats, allowed: Bools) -> None:
        self.tables, self.positions, self.density, self.allowed = tables, positions, density, allowed

    def nearest(self, first: int, reach: int) -> Integers:
        """The ``reach`` source points nearest to one, it among them, ascending."""
        away = ((self.positions - self.positions[first]) ** 2).sum(axis=1)
        return np.sort(np.argsort(away, kind="stable")[:reach])

    def __call__(self, some: Integers, points: Integers, images: Integers) -> Hypotheses:
        """Hypotheses (K,) of solved triples (K, 3) and their roots and images (K, 4), judged by some points alone."""
        n = len(self.positions)
        every = len(some) == n
        tables = self.tables if every else select_sources(self.tables, some, n)
        allowed = self.allowed[some] if self.allowed.size and not every else self.allowed
        evidence, best, candidates = verify(tables, np.searchsorted(some, points), images, self.density, allowed)
        if every:
            return Hypotheses(points, images, evidence, best, candidates)
        whole = np.full((len(points), n), -1)
        whole[:, some] = best
        more = np.full((len(points), n, candidates.shape[2]), -1)
        more[:, some] = candidates
        return Hypotheses(points, images, evidence, whole, more)


def grow_lead(
    lead: Lead, verified: PartialVerification, minimum: float, solutions: int, rng: np.random.Generator
) -> tuple[Hypotheses, int]:
    """Hypotheses of the whole object that a lead grows to, none where it does not, and points looked up for them.

    Parameters
    ----------
    lead : Lead
    verified : PartialVerification
    minimum : float
        Evidence below which a stage is taken to have failed.
    solutions : int
        Most solutions of a triple.
    rng : Generator
    """
    n, looked_up = len(lead.best), 0
    first, best, reach = int(lead.points[0]), lead.best, VERIFIED
    while True:
        last, reach = reach >= n, min(n, int(STRIDE * reach))
        chosen = widest_sets(verified.positions, np.flatnonzero(best >= 0), 3, WIDE_SETS, rng)
        points, images = at_every_root(chosen, best[chosen], solutions)
        found = verified(verified.nearest(first, reach), points, images)
        looked_up += len(points) * reach
        strongest = int(found.evidence.argmax())
        if not found.evidence[strongest] > minimum:
            return Hypotheses.empty(3, n, found.candidates.shape[2]), looked_up
        if last:
            return found.take(found.evidence > -np.inf), looked_up
        best = found.best[strongest]

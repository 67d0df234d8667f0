"""A few steps of a reweighted random walk, as a start of the discrete ascent."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rootmatch.hypergraph.assignment import discretise
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.decorators import driver
from rootmatch.solvers.ascent.pair_table import place_of_pair
from rootmatch.solvers.ascent.subset_index import SubsetIndex
from rootmatch.solvers.rrwhm import ReweightedWalk

HEAVIEST, HEAVIEST_PART = 128, 8
"""Correspondences that keep their mass after a step where there is a table of pairs: so many or, if that is more, one
of so many. 127.65 against 127.65 and 80.4 against 80.3 of the full walk on 80 instances
(docs/notebook/performance.md)."""

WALK = ReweightedWalk()
"""The walk, but for the number of its steps."""


@lru_cache(maxsize=16)
def _walk_with_steps(steps: int) -> ReweightedWalk:
    """The walk of so many steps: match after match the same, and checking its options takes longer than the walk."""
    return replace(WALK, iterations=steps)


def random_walk_start(index: SubsetIndex, steps: int) -> NDArray[np.int64]:
    """Assignment (n,) after some steps of `ReweightedWalk`.

    With a table of pairs, after each step only the heaviest correspondences keep their mass: then few pairs are looked
    up instead of all hyper-edges. As a start it is as good: the ascents from it come as high.
    """
    shape = (index.n, index.n_target)
    if not index.paired:
        tensor = AffinityTensor.unchecked(index.indices, index.weights, shape, index.unary.reshape(shape))
        return discretise(_walk_with_steps(steps).run_walk(tensor)[0])
    count = index.unary.size
    maximum = max(HEAVIEST, count // HEAVIEST_PART)
    x = np.full(count, 1.0 / count)
    # Of the uniform x; what pairs have in common with the third is each hyper-edge once.
    v = index.marginals / count**2
    for _ in range(steps):
        w = v + index.unary
        moved = WALK.walk_step(w, x.reshape(shape))
        if moved is None:
            break
        new = moved[0].ravel()
        chosen = np.arange(count)
        if maximum < count:
            chosen = np.sort(np.argsort(-new, kind="stable")[:maximum])
            kept = np.zeros(count)
            kept[chosen] = new[chosen]
            new = kept / kept.sum()
        change = float(((new - x) ** 2).sum())
        x = new
        if change < WALK.tolerance:
            break
        v = np.zeros(count)
        _contract_chosen(index, x, chosen, v)
    return discretise(x.reshape(shape))


@driver(nogil=True)
def _contract_chosen(index, x, chosen, v):  # type: ignore[no-untyped-def]
    """Add the contraction of all hyper-edges by x (n n',), which is 0 but at `chosen`, ascending, to v (n n',)."""
    start, others, held = index.start, index.others, index.held
    one = np.uint32(1)
    for p in range(chosen.size):
        a = np.uint32(chosen[p])
        first = place_of_pair(np.uint32(0), a)
        for q in range(p):
            b = np.uint32(chosen[q])
            product, place = x[a] * x[b], first + b
            t, last = start[place], start[place + one]
            while t < last:
                v[others[t]] += product * held[t]
                t += one

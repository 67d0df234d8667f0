"""The solution of a search whose best hypothesis holds most of the weight, so that no solver is needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rootmatch.explain.assessment import fits
from rootmatch.explain.decide import TRUST
from rootmatch.explain.task import MatchingTask
from rootmatch.hypergraph.assignment import one_hot
from rootmatch.hypergraph.support import scores_of
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.samplers.base import SampledTensor
from rootmatch.solvers.base import DOMINANT, Solution

ROUNDS = 4
"""Most rounds in which points are added; hypotheses hardly ever leave any. Not tuned."""


def searched_solution(task: MatchingTask, sampled: SampledTensor) -> Solution | None:
    """The best assignment of a search, completed by what its hyper-edges support; None if a solver is needed.

    No solver is needed if the default one would be used, the search was conclusive, a pose can be fitted to judge the
    assignment, and nothing else can score nearly as much.
    """
    tensor, named, options = sampled.tensor, sampled.assignments, task.options
    if named is None or not len(named) or not sampled.conclusive or sampled.missed > TRUST.missed:
        return None
    if options.solver is not None or options.is_paper or tensor.unary is not None or not fits(task, named[0]):
        return None
    least = DOMINANT * float(tensor.weights.sum())
    scores = scores_of(tensor, named)
    order = np.argsort(-scores, kind="stable")
    if not 0.0 < least <= scores[order[0]]:
        return None
    assignment, gains = completed(tensor, named[order[0]])
    rows = gains.sum(axis=1, keepdims=True)
    others = [number for number in order if np.any((named[number] >= 0) & (named[number] != assignment))]
    return Solution(
        soft=gains / np.where(rows > 0.0, rows, 1.0),
        assignment=assignment,
        score=float(scores_of(tensor, assignment[None])[0]),
        alternatives=[(named[number], float(scores[number])) for number in others[: TRUST.alternatives]],
        converged=True,
        iterations=0,
        statistics={"matched": float((assignment >= 0).sum())},
    )


def completed(tensor: AffinityTensor, assignment: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """An assignment with the free points and detections that its matches support, and the gain (n, n') of each."""
    assignment = assignment.copy()
    for turn in range(ROUNDS + 1):
        gains = np.maximum(tensor.contract(one_hot(assignment, tensor.shape[1])), 0.0)
        matched = np.flatnonzero(assignment >= 0)
        least = TRUST.support * float(np.median(gains[matched, assignment[matched]]))
        free = np.ones(tensor.shape[1], np.bool_)
        free[assignment[matched]] = False
        open_ = np.flatnonzero(assignment < 0)
        possible = np.where(free, gains[open_], 0.0)
        rows, columns = np.nonzero(possible > max(least, 0.0))
        if turn == ROUNDS or not len(rows):
            break
        for place in np.argsort(-possible[rows, columns], kind="stable"):
            point, pixel = open_[rows[place]], columns[place]
            if assignment[point] < 0 and free[pixel]:
                assignment[point], free[pixel] = pixel, False
    return assignment, gains

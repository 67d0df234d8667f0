"""The road: points to tables to hyper-edges to affinities to a tensor to an assignment."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch import arguments
from rootmatch import hyperedges as edges
from rootmatch.affinity import NOISE_KINDS, Affinity, Progress, Residual, affinity, exhaustive_tensor, random_tensor
from rootmatch.assignment import margin as lead
from rootmatch.backends import cpu
from rootmatch.errors import InputError
from rootmatch.guided import Choice, Guided, pays
from rootmatch.kernels.support import supported_answers
from rootmatch.motions import check_motions, label_motions
from rootmatch.poses import Pose, poses_of
from rootmatch.problems.problem import Problem, check_normals, check_points
from rootmatch.significance import TRUE_WEIGHT, log10_false_alarms
from rootmatch.solvers import Solver, get_solver
from rootmatch.tensor import AffinityTensor

PAPER_SAMPLES = 100_000
"""Hyper-edges that the paper's preset draws unless told otherwise."""
EXHAUSTIVE_LIMIT = 4_000_000_000
"""Hyper-edges that are evaluated without asking: about a minute on two cores."""
AMBIGUOUS_MARGIN = 0.1
"""Lead below which a different answer is nearly as good."""
SUPPORT = 0.1
"""Share of the median support below which a matched point is left unmatched."""
TRUSTED_FALSE_ALARMS = -2.0
"""Decimal logarithm of the number of answers as good that chance may be expected to find in a trusted match."""


class Status(Enum):
    """What became of a match; the text says what to do."""

    MATCHED = "matched: the answer is well supported and leads over every other"
    AMBIGUOUS = (
        "ambiguous: another answer explains the points nearly as well; look at `alternatives`, give normals "
        "or a vertical, or add points that break the symmetry"
    )
    UNTRUSTED = (
        "no trustworthy match: too few hyper-edges agree; check units, camera and vertical, raise the noise, "
        "or look at more hyper-edges"
    )

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, eq=False)
class Match:
    """Which point is which.

    Attributes
    ----------
    assignment : (n,) int64
        Index into the target points; −1 where unmatched.
    score : float
        Total weight of the hyper-edges inside the assignment.
    margin : float
        Lead over the best different answer, 0 (a tie) to 1.
    alternatives : list of ((n,) int64, float)
        The best different answers and their scores, best first.
    soft : (n, n') float64
        Soft assignment of the solver.
    tensor : AffinityTensor
        The affinities that were solved.
    motions : (n,) int64
        Label of the rigid motion, −1 where unmatched.
    status : Status
        Its text says what to do.
    hyperedges : int
        How many hyper-edges were evaluated.
    seconds : float
        Wall-clock time.
    """

    assignment: NDArray[np.int64]
    score: float
    margin: float
    alternatives: list[tuple[NDArray[np.int64], float]]
    soft: NDArray[np.float64]
    tensor: AffinityTensor
    motions: NDArray[np.int64]
    status: Status
    hyperedges: int
    seconds: float
    source: NDArray[np.float64]
    target: NDArray[np.float64]
    problem: Problem

    def pose(self) -> list[Pose | None]:
        """Pose of each motion from its matches, ``(R, t)`` with x_cam = R X + t, by PoseLib (the extra ``pose``).

        For two images the pose takes the first camera's frame to the second's and t has length 1. None for a motion
        with fewer matches than a pose needs.
        """
        return poses_of(self.problem, self.source, self.target, self.assignment, self.motions)


def residuals(
    source: ArrayLike,
    target: ArrayLike,
    problem: Problem,
    source_index: ArrayLike,
    target_index: ArrayLike,
    kind: str | Residual = "joint",
    noise: ArrayLike = 1.0,
) -> NDArray[np.float64]:
    """Residuals (E,) of given hyper-edges.

    Parameters
    ----------
    source : (n, 3) or (n, 2) array
        Points in space, or pixels of the first image.
    target : (n', 2) array
        Pixels.
    problem : Problem
    source_index, target_index : (E, d) int arrays
        The d correspondences of each hyper-edge, no index twice within one.
    kind : str or Residual
        See `Residual`. ``"normalised"`` and ``"joint"`` are in units of ``noise``.
    noise : float or (n',) array
        σ of a pixel coordinate.

    Raises
    ------
    InputError
        If points or indices cannot be used.
    """
    tables = problem.prepare(source, target, noise)
    n, n_target = len(np.asarray(source)), len(np.asarray(target))
    first = arguments.checked_indices(source_index, n, problem.order, "source_index")
    second = arguments.checked_indices(target_index, n_target, problem.order, "target_index")
    if first.shape != second.shape:
        raise InputError(
            f"source_index {first.shape} and target_index {second.shape} differ in shape; give one of each a row"
        )
    chosen = kind if isinstance(kind, Residual) else Residual(kind)
    return cpu.residuals(tables, chosen.kernel_kind(problem.pair_count), first, second)


def match(
    source: ArrayLike,
    target: ArrayLike,
    problem: Problem,
    *,
    noise: ArrayLike = 1.0,
    seed: int = 0,
    preset: Literal["paper"] | None = None,
    hyperedges: Literal["auto", "exhaustive", "random", "guided"] | Choice | None = None,
    samples: int | None = None,
    residual: str | Residual | None = None,
    rho: float | None = None,
    solver: str | Solver | None = None,
    normals: ArrayLike | None = None,
    candidates: ArrayLike | None = None,
    motions: int | Literal["auto"] = 1,
    backend: Literal["auto", "cpu"] = "auto",
    max_hyperedges: int = 5_000_000,
    limit: int = EXHAUSTIVE_LIMIT,
    progress: Progress | None = None,
) -> Match:
    """Find which point is which from geometry alone.

    Parameters
    ----------
    source : (n, 3) or (n, 2) array
        Points in space in any frame and unit, or pixels of the first image.
    target : (n', 2) array
        Pixels, in any order, clutter among them.
    problem : Problem
        `P3P`, `UP2P` or `ThreePlusOne`.
    noise : float or (n',) array
        Standard deviation of a pixel coordinate, in pixels.
    seed : int
        Of everything random.
    preset : "paper", optional
        The method as the paper has it: random hyper-edges, |R₂ₙ,₂ₙ| of one pair, one ρ, ℓ¹ power iteration; every point
        is matched. Other arguments override parts of it. Default: all hyper-edges, joint residual, multi-start ascent.
    hyperedges : {"auto", "exhaustive", "random", "guided"} or Choice
        Which are looked at: all, random ones, or those that a search by prediction proposes (`rootmatch.guided.Guided`
        is such a choice and has its options). ``"auto"`` is ``"guided"`` where there are more than two million, or with
        several motions 200 million.
    samples : int
        How many random hyper-edges.
    residual : str or Residual
    rho : float
        Spread of the affinity; see `rootmatch.affinity.Affinity`. Default: 1 for residuals in units of the noise, else
        `Problem.paper_rho`.
    solver : str or Solver
    normals : (n, 3) array, optional
        Outward normals of the source points: a point is seen only from its front. Zero rows for unknown.
    candidates : (n, n') array, optional
        Bool: which correspondences are possible. Numbers: prior weights, of which zeros forbid.
    motions : int or "auto"
        Into how many rigid motions the matches are divided.
    backend : {"auto", "cpu"}
    max_hyperedges : int
        Most hyper-edges kept, the strongest; 24 bytes each at order 4.
    limit : int
        Most hyper-edges that an exhaustive search may look at.
    progress : callable, optional
        Called with (done, total) between blocks.

    Returns
    -------
    Match

    Raises
    ------
    InputError
        If the input cannot be used or is larger than the limits; the text says what to do.
    """
    started = time.perf_counter()
    paper = arguments.is_paper(preset)
    check_motions(motions)
    arguments.check_choice("backend", backend, ("auto", "cpu"))
    points = check_points(source, problem.source_dimension, "source", problem.order)
    pixels = check_points(target, problem.target_dimension, "target", problem.order)
    n, n_target = len(points), len(pixels)
    residual = residual or ("qr" if paper else "joint")
    in_noise = (residual.kind if isinstance(residual, Residual) else residual) in NOISE_KINDS
    weigh = affinity(residual, rho if rho is not None or in_noise else problem.paper_rho)
    kind = weigh.residual.kernel_kind(problem.pair_count)
    solve = get_solver(solver or ("power-l1" if paper else "ascent"))
    allowed, unary = arguments.split_candidates(candidates, n, n_target)

    way = hyperedges or ("random" if paper or samples is not None else "auto")
    if not callable(way):
        arguments.check_choice("hyperedges", way, ("auto", "exhaustive", "random", "guided"))
    order = edges.wide_first(points)
    facing = None if normals is None else check_normals(normals, n)[order]
    tables = problem.prepare(points[order], pixels, noise, facing)
    mask = None if allowed is None else allowed[order]
    share, chance = 1.0, None
    if way == "auto" and pays(tables, (n, n_target), problem.order, motions, mask):
        way = "guided"
    if way == "guided":
        way = Guided()
    if callable(way):
        tensor, evaluated, share, chance = way(
            tables, kind, weigh, (n, n_target), problem.order,
            seed=seed, motions=motions, candidates=mask, progress=progress,
        )  # fmt: skip
    elif way == "random":
        count = PAPER_SAMPLES if samples is None else int(samples)
        tensor, evaluated = random_tensor(
            tables, kind, weigh, (n, n_target), problem.order, count, seed, candidates=mask, progress=progress
        )
        # a random sample sees each hyper-edge with this probability
        share = -math.expm1(-evaluated / edges.exhaustive_count(n, n_target, problem.order))
    else:
        arguments.check_size(n, n_target, problem.order, limit, mask)
        tensor, evaluated = exhaustive_tensor(
            tables, kind, weigh, (n, n_target), problem.order,
            max_hyperedges=max_hyperedges, candidates=mask, progress=progress,
        )  # fmt: skip
    tensor = _restored(tensor, order, unary)

    solution = solve(tensor, seed=seed)
    if paper:
        assignment, score, alternatives = solution.assignment, solution.score, solution.alternatives
    else:
        assignment, score, alternatives = _supported(solution.assignment, solution.alternatives, tensor)
    lead_over = lead(score, alternatives, assignment)
    labels = label_motions(assignment, tensor, motions)
    return Match(
        assignment=assignment,
        score=score,
        margin=lead_over,
        alternatives=alternatives,
        soft=solution.soft,
        tensor=tensor,
        motions=labels,
        status=_status(problem, score, lead_over, alternatives, tensor, weigh, evaluated, share, chance),
        hyperedges=evaluated,
        seconds=time.perf_counter() - started,
        source=points,
        target=pixels,
        problem=problem,
    )


def _supported(
    assignment: NDArray[np.int64], alternatives: list[tuple[NDArray[np.int64], float]], tensor: AffinityTensor
) -> tuple[NDArray[np.int64], float, list[tuple[NDArray[np.int64], float]]]:
    """Answers without the points that nothing supports, distinct, best first."""
    asked = np.array([assignment, *(other for other, _ in alternatives)])
    kept, scores = supported_answers(tensor.indices, tensor.weights, tensor.unary, tensor.shape[1], asked, SUPPORT)
    answers = {answer.tobytes(): (answer, float(value)) for answer, value in zip(kept, scores, strict=True)}
    ranked = sorted(answers.values(), key=lambda pair: -pair[1])
    (best, score), rest = ranked[0], ranked[1:]
    # an answer that merely leaves some of the points out is not a different one
    different = [pair for pair in rest if np.any((pair[0] >= 0) & (pair[0] != best))]
    return best, score, different


def _status(
    match_of: Problem,
    score: float,
    margin: float,
    alternatives: list[tuple[NDArray[np.int64], float]],
    tensor: AffinityTensor,
    weigh: Affinity,
    evaluated: int,
    share: float,
    chance: float | None,
) -> Status:
    """Whether chance could have found as good an answer, and whether another answer is nearly as good.

    ``share`` is the part of the hyper-edges inside an answer that was looked at, ``chance`` the mean weight of a random
    one where it is known (otherwise it is that of those outside the answer).
    """
    n, n_target = tensor.shape
    true_weight = TRUE_WEIGHT[match_of.constraints] if weigh.residual.kind in NOISE_KINDS else 1.0
    # what answers of nearly this score share out is structure (a symmetric object), not chance
    explained = score + sum(value for _, value in alternatives if value >= (1.0 - AMBIGUOUS_MARGIN) * score)
    others = max(float(tensor.weights.sum()) - explained, true_weight)
    random = others / evaluated if chance is None else chance
    alarms = log10_false_alarms(match_of, n, n_target, score / max(share, 1e-300), true_weight, random / true_weight)
    if score <= 0.0 or alarms > TRUSTED_FALSE_ALARMS:
        return Status.UNTRUSTED
    return Status.AMBIGUOUS if margin < AMBIGUOUS_MARGIN else Status.MATCHED


def _restored(tensor: AffinityTensor, order: NDArray[np.int64], unary: NDArray[np.float64] | None) -> AffinityTensor:
    """The tensor with source points in the caller's order again, and the prior."""
    n_target = tensor.shape[1]
    source, target = np.divmod(tensor.indices, np.int32(n_target))
    indices = (order.astype(np.int32)[source] * np.int32(n_target) + target).astype(np.int32)
    return AffinityTensor.unchecked(indices, tensor.weights, tensor.shape, unary)

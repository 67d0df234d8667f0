"""The road: points to tables to hyper-edges to affinities to a tensor to an assignment."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.backends import cpu, selection
from rootmatch.backends.strongest import Progress
from rootmatch.errors import InputError
from rootmatch.hypergraph.affinity import NOISE_KINDS, Residual, affinity
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.pipeline import validation
from rootmatch.pipeline.assessment import Status, of_all, of_groups
from rootmatch.pipeline.motion_labels import check_motions, label_motions
from rootmatch.pipeline.multi_motion import several
from rootmatch.pipeline.noise_estimation import first_guess, with_estimated_noise
from rootmatch.pipeline.poses import Pose, poses_of
from rootmatch.pipeline.posterior import Evidence
from rootmatch.pipeline.road import Road
from rootmatch.pipeline.sampling import WAYS, Way
from rootmatch.problems.base import Problem
from rootmatch.problems.checks import check_normals, check_points
from rootmatch.samplers.base import Sampler
from rootmatch.solvers import Solver, get_solver

__all__ = ["Match", "Status", "match", "residuals"]


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
        Lead over all other answers, 0 (a tie) to 1: 1 − (1 − p) / p with the answer's probability p. Where problem or
        residual have none (derived problems, several motions, residuals of the paper), and where nothing comes near:
        lead in score over the best different answer.
    alternatives : list of ((n,) int64, float)
        The best other answers and their scores, the most probable first.
    soft : (n, n') float64
        Soft assignment of the solver.
    tensor : AffinityTensor
        The affinities that were solved.
    motions : (n,) int64
        Label of the rigid motion, −1 where unmatched.
    status : Status
        Whether to believe it; `advice` says what to do.
    hyperedges : int
        How many hyper-edges were evaluated.
    seconds : float
        Wall-clock time.
    noise : float, array or pair
        σ that was used, estimated where that was asked for.
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
    noise: Any

    @property
    def advice(self) -> str:
        """The status in a sentence, with what can be done about it where this problem is solved."""
        return self.status.advice(self.problem)

    def pose(self) -> list[Pose | None]:
        """Pose of each motion from its matches; see `Pose` for frames and units.

        Of cameras by PoseLib (the extra ``pose``), between two point sets by least squares in closed form. None for a
        motion with fewer matches than a pose needs (`Problem.least_for_pose`).

        Raises
        ------
        InputError
            If the problem fits no poses: `UP2PF` and derived ones.
        RootmatchError
            If PoseLib is needed and not installed.
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
    first = validation.checked_indices(source_index, n, problem.order, "source_index")
    second = validation.checked_indices(target_index, n_target, problem.order, "target_index")
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
    noise: ArrayLike | Literal["auto"] = 1.0,
    seed: int = 0,
    preset: Literal["paper"] | None = None,
    hyperedges: Way | Sampler | None = None,
    samples: int | None = None,
    residual: str | Residual | None = None,
    rho: float | None = None,
    solver: str | Solver | None = None,
    normals: ArrayLike | None = None,
    candidates: ArrayLike | None = None,
    motions: int | Literal["auto"] = 1,
    backend: selection.Name = "auto",
    max_hyperedges: int = 5_000_000,
    limit: int | None = None,
    scheduler: str | None = None,
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
    noise : float, (n',) array or "auto"
        Standard deviation of a pixel coordinate, in pixels. ``"auto"``: estimated from the answer, by matching a few
        times.
    seed : int
        Of everything random.
    preset : "paper", optional
        The method as the paper has it: random hyper-edges, |R₂ₙ,₂ₙ| of one pair, a ρ for each problem, power iteration
        with ℓ¹ rows; every point is matched. Other arguments override parts of it: ``solver="power-l1-balanced"`` is
        better where n = n'. Default: all hyper-edges, joint residual, multi-start ascent.
    hyperedges : {"auto", "exhaustive", "random", "guided"} or Sampler
        Which are looked at: all, random ones, or those that a search by prediction proposes
        (`rootmatch.samplers.guided.sampler.Guided` is such a sampler and has its options;
        `rootmatch.samplers.completion.Completion` is another; one of your own takes a
        `rootmatch.samplers.base.SamplingTask`). ``"auto"`` is ``"guided"`` where there are more than two million. With
        several motions it is ``"guided"`` beyond 200 million, or where the problem allows it all that agree are found
        by completing minimal sets.
    samples : int
        How many random hyper-edges.
    residual : str or Residual
    rho : float
        Spread of the affinity; see `rootmatch.hypergraph.affinity.Affinity`. Default: 1 for residuals in units of the
        noise, else `Problem.paper_rho`.
    solver : str or Solver
    normals : (n, 3) array, optional
        Outward normals of the source points: a point is seen only from its front. Zero rows for unknown.
    candidates : (n, n') array, optional
        Bool: which correspondences are possible. Numbers: prior weights, of which zeros forbid.
    motions : int or "auto"
        Into how many rigid motions the matches are divided.
    backend : {"auto", "cpu", "cuda", "cuda-float32"}
        What evaluates hyper-edges and contracts the tensor: processor cores, or an NVIDIA card through numba-cuda (the
        extra ``gpu``). ``"auto"`` is the card where there is one and 200 million hyper-edges or more are looked at. A
        guided search runs on the processor; with ``"cuda"`` it is chosen only beyond a thousand million hyper-edges.
        ``"cuda-float32"`` looks at all hyper-edges in single precision and again in double at those that pass: for
        ``"joint"`` and ``"normalised"`` of P3P and up2p, where ``"auto"`` takes it on cards that are slow in double.
    max_hyperedges : int
        Most hyper-edges kept, the strongest; 24 bytes each at order 4.
    limit : int
        Most hyper-edges that an exhaustive search may look at; by default 4e9 on the processor, 1e11 on a card.
    scheduler : str, optional
        Address of a Dask scheduler (the extra ``cluster``), ``tcp://host:port``: blocks of hyper-edges, all of them or
        random ones, go to its workers, and the tensor is the same to the last bit. They need this package in this
        version.
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
    if isinstance(noise, str):
        validation.check_choice("noise", noise, ("auto",))
        guess = first_guess(check_points(target, problem.target_dimension, "target", problem.order))

        def attempt(sigma: float) -> Match:
            return match(
                source, target, problem, noise=guess if np.isnan(sigma) else sigma, seed=seed, preset=preset,
                hyperedges=hyperedges, samples=samples, residual=residual, rho=rho, solver=solver, normals=normals,
                candidates=candidates, motions=motions, backend=backend, max_hyperedges=max_hyperedges, limit=limit,
                scheduler=scheduler, progress=progress,
            )  # fmt: skip

        return replace(with_estimated_noise(attempt), seconds=time.perf_counter() - started)
    paper = validation.is_paper(preset)
    check_motions(motions)
    validation.check_choice("backend", backend, selection.NAMES)
    points = check_points(source, problem.source_dimension, "source", problem.order)
    pixels = check_points(target, problem.target_dimension, "target", problem.order)
    n, n_target = len(points), len(pixels)
    residual = residual or ("qr" if paper else "joint")
    in_noise = (residual.kind if isinstance(residual, Residual) else residual) in NOISE_KINDS
    weigh = affinity(residual, rho if rho is not None or in_noise else problem.paper_rho)
    weigh.residual.kernel_kind(problem.pair_count)  # refuses pairs that the problem does not have
    solve = get_solver(solver or ("power-l1" if paper else "ascent"))
    allowed, unary = validation.split_candidates(candidates, n, n_target)
    way = hyperedges or ("random" if paper or samples is not None else "auto")
    if not callable(way):
        validation.check_choice("hyperedges", way, WAYS)
    facing = None if normals is None else check_normals(normals, n)
    road = Road(
        problem, points, pixels, noise, weigh, facing, allowed, unary, motions, max_hyperedges, limit, seed, progress,
        backend, scheduler,
        # The order of the points decides which resultant a hyper-edge has; the paper prefers none. A search does.
        as_given=paper and way in ("random", "exhaustive"),
    )  # fmt: skip
    weighed = road.tensor(way, samples)

    if motions != 1 and solver is None and not paper:
        solution, weighed = several(road, weighed)
        verdict = of_groups(solution, (n, n_target))
    else:
        solution = solve(weighed.tensor, seed=seed)
        evidence = Evidence(problem, points, pixels, noise, allowed, unary, facing)
        verdict = of_all(solution, weighed, problem, weigh, paper, evidence)
    labels = solution.groups
    if labels is None:
        labels = label_motions(verdict.assignment, weighed.tensor, motions)
    return Match(
        assignment=verdict.assignment,
        score=verdict.score,
        margin=verdict.margin,
        alternatives=verdict.alternatives,
        soft=solution.soft,
        tensor=weighed.tensor,
        motions=labels,
        status=verdict.status,
        hyperedges=weighed.evaluated,
        seconds=time.perf_counter() - started,
        source=points,
        target=pixels,
        problem=problem,
        noise=noise,
    )

"""One unit of work: the scenes of one seed, one stream of hyper-edges, all methods on all prefixes of the stream."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.arrays import Floats, Integers
from rootmatch.backends import cpu
from rootmatch.hypergraph.affinity import NOISE_KINDS, Affinity, Residual, affinity
from rootmatch.hypergraph.enumeration import exhaustive_count, farthest_point_order, random_hyperedges
from rootmatch.hypergraph.rows import row_keys, unique_rows
from rootmatch.hypergraph.tensor import AffinityTensor
from rootmatch.jit.threads import use_one_thread
from rootmatch.problems import residual_kinds
from rootmatch.problems.base import Problem
from rootmatch.problems.three_plus_one import ThreePlusOne
from rootmatch.research.paper.settings import Method, Setting
from rootmatch.research.store import Row
from rootmatch.samplers.exhaustive import exhaustive_residuals
from rootmatch.simulation import Scene
from rootmatch.solvers import MultiStartAscent, PowerIteration, Solver

BLOCK = 1 << 14
"""Draws evaluated at once. The compiler may round the last few of a block otherwise than the rest, so blocks always
begin at the same draws and are always whole: a residual then does not depend on how many are asked for."""

MAX_SWEPT = 8_000_000
"""Hyper-edges up to which all are evaluated for the default pipeline: neighbours share the roots of a minimal set, so
that takes less time than a million in the order of the stream."""

NOISE_FLOOR = 0.01
"""σ in pixels told to the default pipeline for noise-free scenes: with 0 it would weigh nothing but rounding errors."""

SOLVERS: dict[str, Solver] = {
    "power-l1": PowerIteration("l1", keep=0),
    "power-l1-start": PowerIteration("l1", bias=1.0, keep=0),
    "power-l1-balanced": PowerIteration("l1", normalise="smaller", keep=0),
    "power-dense": PowerIteration("l2", keep=0),
    "power-dense-start": PowerIteration("l2", bias=1.0, keep=0),
    "ascent": MultiStartAscent(keep=0),
}
"""Solvers without alternatives, which a sweep does not need; those with ``-start`` add the start value to each iterate,
as the published code does."""

_ONE_AT_A_TIME = threading.Lock()
"""Held by the unit in work: a cluster's worker may have several threads, and Numba's simplest one has none to share."""


@dataclass(frozen=True)
class Task:
    """One setting and what is to be tried on it: methods, each with its sample sizes."""

    setting: Setting
    methods: tuple[tuple[Method, tuple[int, ...]], ...]


@dataclass(frozen=True)
class Unit:
    """Tasks that share a seed and a stream of hyper-edges, that is, the numbers of points and the order."""

    seed: int
    tasks: tuple[Task, ...]

    @property
    def rows(self) -> int:
        """How many rows it yields."""
        return sum(len(sizes) for task in self.tasks for _, sizes in task.methods)


class Stream:
    """A random stream of hyper-edges, with the repeated ones known.

    Attributes
    ----------
    source, target : (E, d) int32 arrays
        Indices of the points of each hyper-edge drawn.
    group : (E,) int64 array
        Which different hyper-edge each is, numbered in the order of first appearance.
    indices : (G, d) int32 array
        Flat correspondences of the different ones, so those of a prefix of the stream are a prefix.
    seen : (E,) int64 array
        How many different ones the stream has shown up to and with each draw.
    """

    def __init__(self, shape: tuple[int, int], order: int, count: int, seed: int) -> None:
        blocks = list(random_hyperedges(*shape, order, count, seed))
        self.source = np.concatenate([block[0] for block in blocks])
        self.target = np.concatenate([block[1] for block in blocks])
        rows = np.sort((self.source * shape[1] + self.target).astype(np.int32), axis=1)
        base = math.prod(shape)
        self.base = base
        first, sorted_group = unique_rows(rows, base)
        self.group = np.argsort(np.argsort(first))[sorted_group]
        self.indices = np.ascontiguousarray(rows[np.sort(first)])
        self.seen = np.maximum.accumulate(self.group) + 1

    @cached_property
    def _sorted(self) -> tuple[Integers, NDArray[np.intp]]:
        keys = row_keys(self.indices, self.base)
        order = np.argsort(keys)
        return keys[order], order

    def find_groups(self, rows: NDArray[np.int32]) -> NDArray[np.intp]:
        """Group of each row of ascending correspondences; −1 for those that are not in the stream."""
        keys, order = self._sorted
        wanted = row_keys(rows, self.base)
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return np.where(keys[place] == wanted, order[place], -1)


def nested_tensors(
    stream: Stream,
    indices: NDArray[np.int32],
    residual: Floats,
    weigh: Affinity,
    shape: tuple[int, int],
    sizes: tuple[int, ...],
) -> Iterator[tuple[int, AffinityTensor]]:
    """The tensors H_s of the first s draws, s ascending; ``indices`` are those of the stream, in the scene's own order.

    A hyper-edge drawn again is the same entry; the order of its points may be another, and with it the minimal sets
    that are compared, so the lesser residual counts, as in `AffinityTensor.merged`. Weights below 10⁻¹² are left out
    (`Affinity.gate`).
    """
    minimum = np.full(len(indices), np.inf)
    start = 0
    for size in sorted(sizes):
        np.fmin.at(minimum, stream.group[start:size], residual[start:size])
        start = size
        known = minimum[: stream.seen[size - 1]]
        keep = np.flatnonzero(known <= weigh.gate)
        yield size, AffinityTensor.unchecked(indices[keep], weigh.weights(known[keep]), shape)


def evaluate(unit: Unit) -> list[Row]:
    """All rows of a unit; they depend on the unit alone, not on threads, processes or what else is in it."""
    with _ONE_AT_A_TIME, use_one_thread():
        return list(_evaluate(unit))


def _evaluate(unit: Unit) -> Iterator[Row]:
    streams: dict[tuple[tuple[int, int], int], Stream] = {}
    count = max(max(sizes) for task in unit.tasks for _, sizes in task.methods)
    for task in unit.tasks:
        scene = task.setting.scene(unit.seed)
        shape = (len(scene.source), len(scene.target))
        key = shape, scene.problem.order
        if key not in streams:
            streams.clear()  # tasks of one unit share a stream; should they not, one at a time is held
            streams[key] = Stream(*key, -(-count // BLOCK) * BLOCK, unit.seed)
        yield from _rows(unit.seed, task, scene, streams[key], shape)


def _residuals_as_drawn(stream: Stream, tables: Any, kernel: residual_kinds.Kind, draws: int) -> Floats:
    """Residuals of the first draws, the points of each in the order that was drawn, as the paper has it."""
    starts = range(0, draws, BLOCK)
    blocks = [(stream.source[k : k + BLOCK], stream.target[k : k + BLOCK]) for k in starts]
    return np.concatenate([cpu.residuals(tables, kernel, *block) for block in blocks])


def _residuals_in_one_order(
    stream: Stream, tables: Any, kernel: residual_kinds.Kind, gate: float, shape: tuple[int, int]
) -> Floats:
    """Residuals (G,) of the stream's different hyper-edges, source points increasing; infinite above the gate."""
    count, order = stream.indices.shape
    residual = np.full(-(-count // BLOCK) * BLOCK, np.inf)
    if exhaustive_count(*shape, order) <= MAX_SWEPT:
        rows, found, _ = exhaustive_residuals(tables, kernel, gate, shape, order, max_hyperedges=MAX_SWEPT)
        group = stream.find_groups(rows)
        residual[group[group >= 0]] = found[group >= 0]
        return residual
    whole = np.resize(stream.indices, (len(residual), order))
    for k in range(0, len(whole), BLOCK):
        residual[k : k + BLOCK] = cpu.residuals(tables, kernel, *np.divmod(whole[k : k + BLOCK], shape[1]))
    return residual


def _kind_and_problem(residual: str, problem: Problem) -> tuple[str, Problem]:
    """The kind of a method's residual, and the problem with the unknown that the method has."""
    if residual.endswith("-cos") and isinstance(problem, ThreePlusOne):
        return residual.removesuffix("-cos"), replace(problem, unknown="cos")
    return residual, problem


def _rows(seed: int, task: Task, scene: Scene, stream: Stream, shape: tuple[int, int]) -> Iterator[Row]:
    """Rows of one task: each kind of residual is evaluated once, and each tensor is made once, for all its solvers.

    As in `rootmatch.match`, the stream counts the source points as the scene has them for the paper's residuals, and
    from those far apart on for residuals in units of the noise; so a row of the paper's method is what
    `match(..., preset="paper", samples=s, rho=rho, solver=solver, seed=seed)` finds.
    """
    names = list(dict.fromkeys(method.residual for method, _ in task.methods))
    for name in names:
        kind, problem = _kind_and_problem(name, scene.problem)
        order = farthest_point_order(scene.source) if kind in NOISE_KINDS else np.arange(shape[0])
        tables = problem.prepare(scene.source[order], scene.target, max(scene.noise, NOISE_FLOOR))
        own = np.arange(math.prod(shape), dtype=np.int32).reshape(shape)[order].ravel()
        indices = own[stream.indices]
        methods = [(method, sizes) for method, sizes in task.methods if method.residual == name]
        chosen = Residual(kind)
        kernel = chosen.kernel_kind(scene.problem.pair_count)
        draws = max(max(sizes) for _, sizes in methods)
        if kind in NOISE_KINDS:
            gate = max(affinity(chosen, method.rho).gate for method, _ in methods)
            residual = _residuals_in_one_order(stream, tables, kernel, gate, shape)[stream.group[:draws]]
        else:
            residual = _residuals_as_drawn(stream, tables, kernel, draws)
        for rho in dict.fromkeys(method.rho for method, _ in methods):
            same_rho = [(method, sizes) for method, sizes in methods if method.rho == rho]
            sizes = tuple(sorted({size for _, sizes in same_rho for size in sizes}))
            for size, tensor in nested_tensors(
                stream=stream, indices=indices, residual=residual, weigh=affinity(chosen, rho), shape=shape, sizes=sizes
            ):
                for method, wanted in same_rho:
                    if size not in wanted:
                        continue
                    solution = SOLVERS[method.solver](tensor, seed=seed)
                    accuracy = scene.accuracy(solution.assignment)
                    yield Row.of((task.setting, method, seed, size), accuracy, solution, tensor.size)

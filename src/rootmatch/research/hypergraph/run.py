"""The public protocols from points to table and figure, in one call that resumes where it stopped."""

from __future__ import annotations

import timeit
from functools import partial
from pathlib import Path

import numpy as np

from rootmatch.errors import InputError
from rootmatch.jit.threads import use_one_thread
from rootmatch.research.hypergraph.protocol import DEFORMATION, SETTINGS, instance, protocol_tensor
from rootmatch.research.hypergraph.report import Results, write
from rootmatch.research.output_files import count_text
from rootmatch.research.paper.settings import Method, Setting
from rootmatch.research.paper.work_unit import Unit
from rootmatch.research.store import Row, Store
from rootmatch.research.sweep import Plan, Stage, accuracies, check_jobs, complete
from rootmatch.solvers import (
    BlockCoordinateAscent,
    KLProjection,
    MultiStartAscent,
    PowerIteration,
    ReweightedWalk,
    Solver,
)

STORE_NAME = "hypergraph-solvers.sqlite"
MAX_INSTANCES = 1_000_000
TIMED_NOISE, TIMED_INSTANCES, TIMED_REPEATS = 0.2, 5, 5

SOLVERS: dict[str, Solver] = {
    "power-dense": PowerIteration("l2", iterations=100, keep=0),
    "power-l1": PowerIteration("l1", iterations=100, keep=0),
    "power-l1-balanced": PowerIteration("l1", normalise="smaller", iterations=100, keep=0),
    "hgm": KLProjection(keep=0),
    "rrwhm-published": ReweightedWalk(slack=False, keep=0),
    "rrwhm": ReweightedWalk(keep=0),
    "rrwhm-soft": ReweightedWalk(walk=0.8, keep=0),
    "bcagm": BlockCoordinateAscent(keep=0),
    "ascent": MultiStartAscent(keep=0),
}
"""All solvers by their names in `rootmatch.solvers.SOLVERS`, on the same tensors, without alternatives."""


def make_plan(settings: dict[str, tuple[Setting, ...]]) -> Plan:
    """Every solver on every setting."""
    return {
        setting: tuple((Method("sines", name, 1.0), (_triangles(setting),)) for name in SOLVERS)
        for chosen in settings.values()
        for setting in chosen
    }


def _triangles(setting: Setting) -> int:
    """Triangles drawn, n·n'."""
    points = instance(setting, 0)
    return len(points.source) * len(points.target)


def evaluate(unit: Unit) -> list[Row]:
    """Rows of one seed: a tensor for each setting, all solvers on it, one thread."""
    rows = []
    with use_one_thread():
        for task in unit.tasks:
            points = instance(task.setting, unit.seed)
            tensor = protocol_tensor(points, unit.seed)
            for method, (size,) in task.methods:
                found = SOLVERS[method.solver](tensor, seed=unit.seed)
                accuracy = float(np.mean(found.assignment == points.truth))
                rows.append(Row.of((task.setting, method, unit.seed, size), accuracy, found, tensor.size))
    return rows


def milliseconds() -> dict[str, float]:
    """Median over some instances of the shortest of a few calls of each solver, at n = 20 on one thread.

    The shortest, as other programs can only lengthen a call; each solver is called once before, which compiles it.
    """
    setting = Setting(DEFORMATION, 0, TIMED_NOISE)
    tensors = [protocol_tensor(instance(setting, seed), seed) for seed in range(TIMED_INSTANCES)]
    found = {}
    with use_one_thread():
        for name, solver in SOLVERS.items():
            solver(tensors[0], seed=0)
            shortest = [
                min(timeit.repeat(partial(solver, tensor, seed=0), number=1, repeat=TIMED_REPEATS))
                for tensor in tensors
            ]
            found[name] = 1e3 * float(np.median(shortest))
    return found


def reproduce(
    output: Path,
    *,
    instances: int = 100,
    seed: int = 0,
    jobs: int = -1,
    scheduler: str | None = None,
    progress: Stage | None = None,
    settings: dict[str, tuple[Setting, ...]] = SETTINGS,
) -> tuple[Path, ...]:
    """Run what is missing of both protocols and write the table, the figure and the numbers.

    Parameters
    ----------
    output : Path
        Folder of ``hypergraph-solvers.sqlite``, ``hypergraph.md``, ``hypergraph.csv`` and ``hypergraph.png`` and
        ``.svg``. The same call on the same folder goes on where an earlier one stopped.
    instances, seed, jobs, scheduler, progress
        As of `rootmatch.research.paper.reproduce.reproduce`.
    settings : dict
        Of each protocol; fewer in tests.

    Raises
    ------
    InputError
        For counts out of range, a store that cannot be used or a scheduler that does not answer.
    """
    if instances < 1 or seed < 0 or seed + instances > MAX_INSTANCES:
        raise InputError(
            f"{instances} instances from seed {seed}: give at least one, with seeds from 0 to {MAX_INSTANCES - 1:,}"
        )
    check_jobs(jobs)
    seeds = range(seed, seed + instances)
    plan = make_plan(settings)
    with Store(output / STORE_NAME) as store:
        title = f"hypergraph protocols: {count_text(instances, 'instance')}"
        complete(title, plan, seeds, store, jobs=jobs, scheduler=scheduler, progress=progress, function=evaluate)
        found = accuracies(plan, seeds, store)
    cells = {(setting, method.solver): values for (setting, method, _), values in found.items()}
    return write(Results(settings, tuple(SOLVERS), cells, milliseconds()), output)

"""Runs units of work on this machine's processors or on a cluster, and writes their rows as they come."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, nullcontext
from functools import partial

import joblib
import numpy as np
from numpy.typing import NDArray

from rootmatch.backends.dask import IN_FLIGHT, connect_client, results_in_order
from rootmatch.backends.strongest import Progress
from rootmatch.backends.worker_lifetime import pool
from rootmatch.errors import InputError, RootmatchError
from rootmatch.research.paper.settings import Method, Setting
from rootmatch.research.paper.work_unit import Task, Unit, evaluate
from rootmatch.research.store import Row, Store, versions_in_use

Plan = dict[Setting, tuple[tuple[Method, tuple[int, ...]], ...]]
"""What is to be tried on each setting: methods, each with its sample sizes."""

Stage = Callable[[str], AbstractContextManager[Progress | None]]
"""Begins a stage of a run, by its title, and gives what its progress is told to."""
Evaluate = Callable[[Unit], list[Row]]
Timed = tuple[list[Row], str, float]
"""The rows of a unit, the versions that worked them out, and the seconds that this took."""

MAX_JOBS = 1024
"""Processes on one machine; each takes 200 MB."""


def units(plan: Plan, seeds: Iterable[int], store: Store) -> list[Unit]:
    """The units that are not in the store yet, seed after seed.

    Settings with the same problem and number of outliers have the same stream of hyper-edges and go together. A method
    of which any sample size is missing is run again as a whole.
    """
    there = store.done()
    families: dict[tuple[str, int], list[Setting]] = {}
    for setting in plan:
        families.setdefault((setting.problem, setting.outliers), []).append(setting)
    found = []
    for seed in seeds:
        for family in families.values():
            tasks = []
            for setting in family:
                missing = tuple(
                    (method, sizes)
                    for method, sizes in plan[setting]
                    if not set(sizes) <= there.get((setting, method, seed), set())
                )
                if missing:
                    tasks.append(Task(setting, missing))
            if tasks:
                found.append(Unit(seed, tuple(tasks)))
    return found


def run(
    work: list[Unit],
    store: Store,
    *,
    jobs: int = -1,
    scheduler: str | None = None,
    progress: Progress | None = None,
    function: Evaluate = evaluate,
) -> None:
    """Work out units and write the rows of each in one transaction as soon as it is done.

    Parameters
    ----------
    work : list of Unit
    store : Store
    jobs : int
        Processes on this machine; −1 for one a processor. Not used with a scheduler.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:port``; its workers need this package in this version.
    progress : callable, optional
        Called with (rows done, rows in all) after every unit.
    function : callable
        Works out a unit; another one in tests.

    Raises
    ------
    InputError
        If Dask is not installed or the scheduler does not answer.
    RootmatchError
        If a worker dies; what is done is kept.
    """
    if not work:
        return
    results = _run_on_cluster(work, scheduler, function) if scheduler else _run_here(work, jobs, function)
    done, total = 0, sum(unit.rows for unit in work)
    for rows, versions, seconds in results:
        store.add(rows, versions, seconds)
        done += len(rows)
        if progress is not None:
            progress(done, total)


def complete(
    title: str,
    plan: Plan,
    seeds: range,
    store: Store,
    *,
    jobs: int,
    scheduler: str | None,
    progress: Stage | None,
    function: Evaluate = evaluate,
) -> None:
    """Run what the store lacks of a plan, a stage of the progress with that title; see `run`."""
    if work := units(plan, seeds, store):
        with nullcontext() if progress is None else progress(title) as show:
            run(work, store, jobs=jobs, scheduler=scheduler, progress=show, function=function)


def accuracies(plan: Plan, seeds: range, store: Store) -> dict[tuple[Setting, Method, int], NDArray[np.float64]]:
    """Accuracies (seeds,) of a finished plan, by setting, method and sample size."""
    cells = {}
    for setting, methods in plan.items():
        for method, sizes in methods:
            found = store.accuracies(setting, method, seeds)
            for size in sizes:
                cells[setting, method, size] = np.array([found[size][seed] for seed in seeds])
    return cells


def check_jobs(jobs: int) -> None:
    """Refuse an impossible number of processes."""
    if jobs == 0 or abs(jobs) > MAX_JOBS:
        raise InputError(f"jobs: {jobs} given; give a number of processes, or -1 for one per processor")


def _run_timed(function: Evaluate, unit: Unit) -> Timed:
    start = time.process_time()
    rows = function(unit)
    return rows, versions_in_use(), time.process_time() - start


def _run_here(work: list[Unit], jobs: int, function: Evaluate) -> Iterator[Timed]:
    check_jobs(jobs)
    processes = joblib.effective_n_jobs(jobs)
    if processes == 1:
        yield from (_run_timed(function, unit) for unit in work)
        return
    with warnings.catch_warnings():
        # A worker that has grown by 300 MB, as the compiler makes it, is replaced once it is idle; nothing is lost.
        warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given to the executor")
        try:
            with pool(processes) as workers:
                yield from (
                    one.result() for one in as_completed({workers.submit(_run_timed, function, u) for u in work})
                )
        except BrokenProcessPool:
            raise RootmatchError(
                "a worker process died, perhaps for lack of memory; finished work is kept: run the same command again, "
                "with fewer --jobs if necessary"
            ) from None


def _run_on_cluster(work: list[Unit], scheduler: str, function: Evaluate) -> Iterator[Timed]:
    with connect_client(scheduler) as client:
        ahead = IN_FLIGHT * sum(client.nthreads().values())
        # not pure: Dask would otherwise look the unit's result up by a hash of its input
        submit = partial(client.submit, _run_timed, function, pure=False)
        yield from (result for _, result in results_in_order(submit, iter(work), ahead, "a unit"))

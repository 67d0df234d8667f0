"""The very first match: a second process compiles what comes late in it beside this one."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rootmatch.hypergraph.tensor import AffinityTensor
    from rootmatch.problems.base import Problem
    from rootmatch.solvers import Solution, Solver

LATE = "import sys; from rootmatch.cli.cold import compile_late; compile_late(int(sys.argv[1]), sys.argv[2:])"
"""The second process."""


def compile_late(order: int, parts: list[str]) -> None:
    """Compile what comes late in a match of hyper-edges of that order: the "groups", the "search", the "solver"."""
    from rootmatch.samplers.guided import warm as search
    from rootmatch.solvers import warm as solver

    gc.disable()  # a compiler makes millions of objects and few cycles: a tenth of the time
    if "groups" in parts:
        solver.warm_packing()
    if "search" in parts:
        search.warm()
    if "solver" in parts:
        solver.warm(order)


class Awaiting:
    """A solver whose kernels another process is compiling: it waits for that one, and then finds them in the cache."""

    def __init__(self, solver: Solver, process: subprocess.Popen[Any]) -> None:
        self.solver, self.process = solver, process

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """As the solver itself, should the other process have failed."""
        self.process.wait()
        return self.solver(tensor, seed=seed)


@contextmanager
def compiled_beside(problem: Problem, several: bool) -> Iterator[Solver | None]:
    """Where there are no kernels yet, and two cores, late ones are compiled beside the work inside.

    Gives the solver to be used, which waits for them; None with several motions, whose packing finds what is ready.
    """
    from rootmatch.solvers import get_solver
    from rootmatch.solvers.warm import is_cold

    if not sys.executable or (os.cpu_count() or 1) < 2 or not is_cold(several):
        yield None
        return
    # where poses are fitted to groups there are no ascents, nor a search that proposes
    late = ["groups"] if several else []
    late += [] if several and problem.fits_groups else ["search", "solver"]
    process = subprocess.Popen(
        [sys.executable, "-c", LATE, str(problem.order), *late],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    gc.disable()  # as there
    try:
        yield None if several else Awaiting(get_solver("ascent"), process)
    finally:
        gc.enable()
        process.kill()
        process.wait()

"""The very first match: a second process compiles the solver and a part of the search beside this one."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rootmatch.problems.problem import Problem
    from rootmatch.solvers import Solution, Solver
    from rootmatch.tensor import AffinityTensor

WARM = """
import gc, sys
gc.disable()
from rootmatch.guided import warm as search
from rootmatch.solvers import warm as solver
search.warm(sys.argv[1])
solver.warm(int(sys.argv[2]))
"""


class Awaiting:
    """A solver whose kernels another process is compiling: it waits for that one, and then finds them in the cache."""

    def __init__(self, solver: Solver, process: subprocess.Popen[Any]) -> None:
        self.solver, self.process = solver, process

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """As the solver itself, should the other process have failed."""
        self.process.wait()
        return self.solver(tensor, seed=seed)


@contextmanager
def compiled_beside(problem: Problem) -> Iterator[Solver]:
    """The default solver; its kernels are compiled beside the work inside, where there are none yet and two cores."""
    from rootmatch.solvers import get_solver
    from rootmatch.solvers.warm import is_cold

    solver = get_solver("ascent")
    if not sys.executable or (os.cpu_count() or 1) < 2 or not is_cold():
        yield solver
        return
    process = subprocess.Popen(
        [sys.executable, "-c", WARM, problem.name, str(problem.order)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    gc.disable()  # a compiler makes millions of objects and few cycles: a tenth of the time
    try:
        yield Awaiting(solver, process)
    finally:
        gc.enable()
        process.kill()
        process.wait()

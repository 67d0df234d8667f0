"""The very first match: the solver is compiled by a second process while this one compiles what comes before it."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rootmatch.solvers import Solution, Solver
    from rootmatch.tensor import AffinityTensor

WARM = "import gc; gc.disable(); from rootmatch.solvers.warm import warm; warm()"


class Awaiting:
    """A solver whose kernels another process is compiling: it waits for that one, and then finds them in the cache."""

    def __init__(self, solver: Solver, process: subprocess.Popen[Any]) -> None:
        self.solver, self.process = solver, process

    def __call__(self, tensor: AffinityTensor, *, seed: int = 0) -> Solution:
        """As the solver itself, should the other process have failed."""
        self.process.wait()
        return self.solver(tensor, seed=seed)


@contextmanager
def solver_compiled_beside() -> Iterator[Solver]:
    """The default solver; its kernels are compiled beside the work inside, where there are none yet and two cores."""
    from rootmatch.solvers import get_solver
    from rootmatch.solvers.warm import is_cold

    solver = get_solver("ascent")
    if not sys.executable or (os.cpu_count() or 1) < 2 or not is_cold():
        yield solver
        return
    process = subprocess.Popen(
        [sys.executable, "-c", WARM], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    gc.disable()  # a compiler makes millions of objects and few cycles: a tenth of the time
    try:
        yield Awaiting(solver, process)
    finally:
        gc.enable()
        process.kill()
        process.wait()

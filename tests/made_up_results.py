"""Tables of results that nobody measured, for the tests of what is made of results."""

import numpy as np

from rootmatch.research.paper.plan import Table, make_plan
from rootmatch.research.paper.rho import CONDITIONS, RESIDUALS, SCAN_SOLVERS, Rhos
from rootmatch.research.paper.settings import PROBLEMS, Effort

RHO = {"p3p": 1e-9, "3p1": 1e-7, "up2p": 1e-2}
EXACT = {"p3p": 1e-13, "3p1": 1e-12, "up2p": 1e-5}
ONE = 1e-6
NEEDED = 1e-10
"""The one ρ at which the made-up scan is as the paper says; its mean accuracy is not the highest."""


def made_up_rhos(effort=None):
    """A scan whose peaks are at RHO, at EXACT for noise-free scenes, at ONE for the mean of the problems, lower at
    NEEDED, where alone it is as the paper says. The published solver has its one ρ a decade higher."""
    effort = effort or Effort()

    def peak(rho, height):
        return np.where(np.isclose(effort.grid, rho, rtol=0.1, atol=0.0), height, 0.0)[None]  # one seed

    keys = [
        (r, how, p)
        for r in RESIDUALS
        for how in (SCAN_SOLVERS[:1] if r == "tan" else SCAN_SOLVERS)
        for p in (("3p1",) if r == "tan" else RHO)
    ]
    shift = {how: 10.0**k for k, how in enumerate(SCAN_SOLVERS)}
    as_said = {problem: 0.95 if problem == "3p1" else 1.0 for problem in CONDITIONS}
    return Rhos(
        effort,
        whole={(r, how, p): peak(ONE * shift[how], 0.8) + peak(NEEDED * shift[how], 0.5) for r, how, p in keys},
        own={(r, how, p): peak(RHO[p], 0.9) + peak(ONE, 0.8) for r, how, p in keys},
        exact={(r, how, p): peak(EXACT[p], 1.0) for r, how, p in keys},
        clean={(r, how, p): peak(NEEDED * shift[how], as_said[p]) for r, how, p in keys},
    )


def made_up_table(accuracy, problems=PROBLEMS, instances=12, spread=0.0, effort=None):
    """Table whose cells have the mean ``accuracy(setting, method, samples)``; instances lie ± spread about it."""
    rhos, seeds = made_up_rhos(effort), range(5, 5 + instances)
    wobble = spread * np.where(np.arange(instances) % 2, 1.0, -1.0)
    cells = {
        (setting, method, size): np.clip(accuracy(setting, method, size) + wobble, 0.0, 1.0)
        for setting, methods in make_plan(problems, rhos).items()
        for method, sizes in methods
        for size in sizes
    }
    return Table(problems, seeds, rhos, cells)

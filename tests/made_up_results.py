"""Tables of results that nobody measured, for the tests of what is made of results."""

import numpy as np

from rootmatch.experiments.plan import Table, plan_of
from rootmatch.experiments.rho import GRID, RESIDUALS, Rhos
from rootmatch.experiments.settings import PROBLEMS

RHO = {"p3p": 1e-9, "3p1": 1e-7, "up2p": 1e-2}
EXACT = {"p3p": 1e-13, "3p1": 1e-12, "up2p": 1e-5}
ONE = 1e-6


def made_up_rhos():
    """A scan whose peaks are at RHO, at EXACT for noise-free scenes, and at ONE for the mean of the problems."""

    def peak(rho, height):
        return np.where(np.isclose(GRID, rho, rtol=0.1, atol=0.0), height, 0.0)[None]  # one seed

    return Rhos(
        {(r, p): peak(ONE, 0.8) for r in RESIDUALS for p in RHO},
        {(r, p): peak(rho, 0.9) + peak(ONE, 0.8) for r in RESIDUALS for p, rho in RHO.items()},
        {(r, p): peak(rho, 1.0) for r in RESIDUALS for p, rho in EXACT.items()},
    )


def made_up_table(accuracy, problems=PROBLEMS, instances=12, spread=0.0):
    """Table whose cells have the mean ``accuracy(setting, method, samples)``; instances lie ± spread about it."""
    rhos, seeds = made_up_rhos(), range(5, 5 + instances)
    wobble = spread * np.where(np.arange(instances) % 2, 1.0, -1.0)
    cells = {
        (setting, method, size): np.clip(accuracy(setting, method, size) + wobble, 0.0, 1.0)
        for setting, methods in plan_of(problems, rhos).items()
        for method, sizes in methods
        for size in sizes
    }
    return Table(problems, seeds, rhos, cells)

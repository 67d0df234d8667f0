"""Tables of results that nobody measured, for the tests of what is made of results."""

import numpy as np

from rootmatch.experiments.plan import Table, plan_of
from rootmatch.experiments.rho import GRID, RESIDUALS, Rhos
from rootmatch.experiments.settings import PROBLEMS

RHO = {"p3p": 1e-9, "3p1": 1e-7, "up2p": 1e-2, "all": 1e-6}


def made_up_rhos():
    """A scan with its peaks at RHO, whatever the residual."""
    distance = {name: np.abs(np.log10(GRID) - np.log10(rho)) for name, rho in RHO.items()}
    return Rhos({(r, name): 1.0 / (1.0 + d) for r in RESIDUALS for name, d in distance.items()})


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

"""The spread ρ of the affinity: scanned on scenes of its own and chosen by one rule.

The paper sets ρ "empirically" and keeps it "constant for all the instances and problems". Here it is chosen on seeds
that are not reported, by this rule: of the grid, the ρ with the highest mean accuracy of the sparse solver over all
scanned settings and instances; of several equals the smallest, which keeps the fewest hyper-edges. One ρ for all
problems is chosen on the mean of the problems' means, so that each problem counts alike; a ρ of a problem's own on that
problem's mean alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rootmatch.experiments.settings import PROBLEMS, SCAN_SEED, SCAN_SETTINGS, Method
from rootmatch.experiments.store import Store
from rootmatch.experiments.sweep import Plan

RESIDUALS = ("qr", "qr-both", "svd")
GRID = tuple(float(f"1e{k}") for k in range(-12, 1))
"""ρ from 10⁻¹² to 1 in decades: the residuals of the three problems lie six decades apart."""
SCAN_INSTANCES = 4
SCAN_SAMPLES = 100_000
SCAN_SEEDS = range(SCAN_SEED, SCAN_SEED + SCAN_INSTANCES)
SCAN_SOLVER = "power-l1"


def scan_plan() -> Plan:
    """Every ρ of the grid, for each residual, on each setting of the scan; the problems in turn."""
    methods = tuple((Method(residual, SCAN_SOLVER, rho), (SCAN_SAMPLES,)) for residual in RESIDUALS for rho in GRID)
    by_outliers = sorted((s for p in PROBLEMS for s in SCAN_SETTINGS[p]), key=lambda s: s.outliers)
    return dict.fromkeys(by_outliers, methods)


@dataclass(frozen=True)
class Rhos:
    """What the scan found and what was chosen.

    Attributes
    ----------
    curves : dict of (residual, problem) to (len(GRID),) array
        Mean accuracy at each ρ of the grid; the problem ``"all"`` is the mean of the problems.
    """

    curves: dict[tuple[str, str], NDArray[np.float64]]

    def chosen(self, residual: str, problem: str = "all") -> float:
        """The ρ of a residual, for all problems or for one."""
        return best(self.curves[residual, problem])


def best(curve: NDArray[np.float64]) -> float:
    """The ρ of the grid with the highest mean accuracy, of equals the smallest."""
    # Means of the same hits added up in another order must count as equal.
    return GRID[int(np.argmax(np.round(curve, 9)))]


def choose(store: Store) -> Rhos:
    """Mean accuracies of a finished scan."""
    curves: dict[tuple[str, str], NDArray[np.float64]] = {}
    for residual in RESIDUALS:
        for problem in PROBLEMS:
            methods = [Method(residual, SCAN_SOLVER, rho) for rho in GRID]
            curves[residual, problem] = np.array([_mean_accuracy(store, problem, method) for method in methods])
        curves[residual, "all"] = np.mean([curves[residual, problem] for problem in PROBLEMS], axis=0)
    return Rhos(curves)


def _mean_accuracy(store: Store, problem: str, method: Method) -> float:
    """Over all scanned settings of a problem and all scanned seeds."""
    found = [store.accuracies(setting, method, SCAN_SEEDS)[SCAN_SAMPLES] for setting in SCAN_SETTINGS[problem]]
    return float(np.mean([list(by_seed.values()) for by_seed in found]))

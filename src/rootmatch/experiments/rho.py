"""The spread ρ of the affinity: scanned on scenes of its own and chosen by one rule.

The paper sets ρ "empirically" and keeps it "constant for all the instances and problems". Here it is chosen on seeds
that are not reported, by this rule: of the grid, the ρ with the highest mean accuracy of the sparse solver over the
scanned settings and instances; of several equals the smallest, which keeps the fewest hyper-edges. One ρ for all
problems that were scanned is chosen on the mean of their means, so that each problem counts alike. As noise-free scenes
take a far smaller ρ than noisy ones, and a ρ between serves neither, each problem has two of its own: one chosen on its
noisy scenes alone, one on its noise-free scenes alone.

How firm a choice is, resampled scenes tell: how often another ρ would have been chosen on them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rootmatch.experiments.settings import PROBLEMS, SCAN_SEED, SCAN_SETTINGS, Method, Setting, has_svd
from rootmatch.experiments.statistics import bootstrap_means
from rootmatch.experiments.store import Store
from rootmatch.experiments.sweep import Plan

Rule = Literal["one", "own", "exact"]
RULES: tuple[Rule, ...] = ("one", "own", "exact")
RULE_NAMES: dict[Rule, str] = {
    "one": "one ρ for all problems",
    "own": "a ρ for each problem's noisy scenes",
    "exact": "a ρ for each problem's noise-free scenes",
}
"""Scenes on which ρ is chosen; the first are the paper's."""

RESIDUALS = ("qr", "qr-both", "svd")
GRID = tuple(float(f"1e{k}") for k in range(-16, 1))
"""ρ from 10⁻¹⁶ to 1 in decades: residuals of the three problems lie six decades apart, those of exact data lower."""
SCAN_INSTANCES = {"qr": 24, "qr-both": 12, "svd": 12}
"""Seeds of each scanned setting; the residual of the paper's figures, on which most claims rest, has most of them."""
SCAN_SAMPLES = 100_000
SCAN_SOLVER = "power-l1"


def scan_seeds(residual: str) -> range:
    """The seeds on which a residual is scanned."""
    return range(SCAN_SEED, SCAN_SEED + SCAN_INSTANCES[residual])


def scan_plan(residual: str, problems: tuple[str, ...] = PROBLEMS) -> Plan:
    """Every ρ of the grid on each setting of the scan; the problems in turn."""
    by_outliers = sorted((s for p in problems for s in SCAN_SETTINGS[p]), key=lambda s: s.outliers)
    methods = tuple((Method(residual, SCAN_SOLVER, rho), (SCAN_SAMPLES,)) for rho in GRID)
    return {setting: methods for setting in by_outliers if residual != "svd" or has_svd(setting)}


@dataclass(frozen=True)
class Rhos:
    """What the scan found and what was chosen.

    Attributes
    ----------
    whole, own, exact : dict of (residual, problem) to (seeds, len(GRID)) array
        Accuracy at each ρ of the grid, a mean over all scanned settings of a problem, over its noisy ones and over its
        noise-free ones, for each seed.
    """

    whole: dict[tuple[str, str], NDArray[np.float64]]
    own: dict[tuple[str, str], NDArray[np.float64]]
    exact: dict[tuple[str, str], NDArray[np.float64]]

    @cached_property
    def problems(self) -> tuple[str, ...]:
        """Problems that were scanned."""
        return tuple(problem for problem in PROBLEMS if any(problem == p for _, p in self.whole))

    def by_seed(self, residual: str, problem: str, rule: Rule) -> NDArray[np.float64]:
        """The curve of each seed, (seeds, len(GRID))."""
        if rule == "one":
            mean: NDArray[np.float64] = np.mean([self.whole[residual, p] for p in self.problems], axis=0)
            return mean
        return (self.own if rule == "own" else self.exact)[residual, problem]

    def curve(self, residual: str, problem: str, rule: Rule) -> NDArray[np.float64]:
        """The curve (len(GRID),) whose highest point decides."""
        mean: NDArray[np.float64] = self.by_seed(residual, problem, rule).mean(axis=0)
        return mean

    def chosen(self, residual: str, problem: str, rule: Rule) -> float:
        """The ρ for a residual and a problem; by the rule ``"one"`` it is the same for all problems."""
        key = residual, problem, rule
        if key not in self._chosen:  # asked for with every cell of every table
            self._chosen[key] = best(self.curve(*key))
        return self._chosen[key]

    @cached_property
    def _chosen(self) -> dict[tuple[str, str, Rule], float]:
        return {}

    def choices(self, residual: str, problem: str, rule: Rule) -> dict[float, float]:
        """Each ρ that is chosen on resampled seeds, and on what share of them, the most frequent first."""
        curves = bootstrap_means(self.by_seed(residual, problem, rule))
        found, counts = np.unique([best(curve) for curve in curves], return_counts=True)
        shares = dict(zip(found.tolist(), (counts / len(curves)).tolist(), strict=True))
        return dict(sorted(shares.items(), key=lambda item: -item[1]))


def best(curve: NDArray[np.float64]) -> float:
    """The ρ of the grid with the highest mean accuracy, of equals the smallest."""
    # Means of the same hits added up in another order must count as equal.
    return GRID[int(np.argmax(np.round(curve, 9)))]


def choose(store: Store, problems: tuple[str, ...] = PROBLEMS) -> Rhos:
    """Accuracies of a finished scan."""
    whole, own, exact = {}, {}, {}
    for residual in RESIDUALS:
        for problem in problems:
            settings = [s for s in SCAN_SETTINGS[problem] if residual != "svd" or has_svd(s)]
            by_setting = np.array([_accuracies(store, setting, residual) for setting in settings])
            noise_free = np.array([s.noise == 0.0 for s in settings])
            whole[residual, problem] = by_setting.mean(axis=0)
            own[residual, problem] = by_setting[~noise_free].mean(axis=0)
            exact[residual, problem] = by_setting[noise_free].mean(axis=0)
    return Rhos(whole, own, exact)


def _accuracies(store: Store, setting: Setting, residual: str) -> NDArray[np.float64]:
    """Accuracy of each scanned seed at each ρ of the grid, (seeds, len(GRID))."""
    methods = [Method(residual, SCAN_SOLVER, rho) for rho in GRID]
    found = [store.accuracies(setting, method, scan_seeds(residual))[SCAN_SAMPLES] for method in methods]
    return np.array([[by_seed[seed] for by_seed in found] for seed in scan_seeds(residual)])

"""The spread ρ of the affinity: scanned on scenes of its own and chosen by fixed rules.

The paper sets ρ "empirically" and keeps it "constant for all the instances and problems", without a value. Its value
here is chosen on seeds that are not reported, among the decades of a grid, in four ways:

* ``"paper"``: one ρ for all problems, among those that meet what the paper says of its own noise-free results
  (`CONDITIONS`); of these the one with the highest mean accuracy of the sparse solver. If none meets all of it, those
  that meet most count.
* ``"one"``: one ρ for all problems, the one with the highest mean accuracy.
* ``"own"`` and ``"exact"``: for each problem, on its noisy and on its noise-free scenes alone.

Of several equals the smallest is taken, which keeps the fewest hyper-edges. One ρ for all problems that were scanned is
chosen on the mean of their means, so that each problem counts alike. The solver of the published code has a scan of its
own: what it adds to each iterate has a unit, so it may need another ρ.

How firm a choice is, resampled scenes tell: how often another ρ would have been chosen on them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from rootmatch.arrays import Bools, Floats, Integers
from rootmatch.research.bootstrap import bootstrap_means
from rootmatch.research.paper.settings import (
    BASELINES,
    PROBLEMS,
    SCAN_SETTINGS,
    Effort,
    Method,
    Setting,
    has_svd,
    residual_name,
)
from rootmatch.research.paper.verdict import FULL, LOST
from rootmatch.research.store import Store
from rootmatch.research.sweep import Plan

Rule = Literal["paper", "one", "own", "exact"]
RULES: tuple[Rule, ...] = ("paper", "one")
"""By which the claims are judged."""
ALL_RULES: tuple[Rule, ...] = (*RULES, "own", "exact")
RULE_NAMES: dict[Rule, str] = {
    "paper": "one ρ, as the paper needs it",
    "one": "one ρ, chosen freely",
    "own": "a ρ for each problem's noisy scenes",
    "exact": "a ρ for each problem's noise-free scenes",
}

RESIDUALS = ("qr", "qr-both", "svd", "tan")
"""What is scanned; ``"tan"`` is 3P1 in the other unknown (`rootmatch.research.paper.settings.residual_name`)."""
SPARSE, START = "power-l1", "power-l1-start"
"""The sparse solver of the paper's text, and that of the published code."""
SCAN_SOLVERS = (SPARSE, START)

CONDITIONS: dict[str, tuple[Setting, Callable[[Floats], Bools], str]] = {
    "p3p": (Setting("p3p"), lambda mean: mean >= FULL, "noise-free P3P reaches 100 %"),
    "3p1": (
        Setting("3p1", baseline=BASELINES[1]),
        lambda mean: (mean < FULL) & (mean > LOST),
        "noise-free 3P1 at b = 5 stays under 100 %, but is not at chance level",
    ),
    "up2p": (Setting("up2p"), lambda mean: mean >= FULL, "noise-free up2p reaches 100 %, as it is no worse than P3P"),
}
"""What the paper says of its noise-free results without outliers: the setting, the test of the mean accuracy, words."""


def scan_settings(residual: str, problem: str) -> tuple[Setting, ...]:
    """The settings of a problem on which ρ of a residual is chosen."""
    if residual == "tan" and problem != "3p1":
        return ()
    return tuple(s for s in SCAN_SETTINGS[problem] if residual != "svd" or has_svd(s))


def scan_plan(residual: str, effort: Effort, problems: tuple[str, ...] = PROBLEMS) -> Plan:
    """Every ρ of the grid on each setting of the scan; the problems in turn."""
    settings = sorted((s for p in problems for s in scan_settings(residual, p)), key=lambda s: s.outliers)
    solvers = SCAN_SOLVERS[:1] if residual == "tan" else SCAN_SOLVERS
    sizes = (effort.scan_samples(residual),)
    return {
        s: tuple((Method(residual_name(s.problem, residual), how, r), sizes) for how in solvers for r in effort.grid)
        for s in settings
    }


Key = tuple[str, str, str]
"""Residual, solver, problem."""


@dataclass(frozen=True)
class Rhos:
    """Results of the scan of ρ, and the chosen values."""

    effort: Effort
    whole: dict[Key, Floats]
    own: dict[Key, Floats]
    exact: dict[Key, Floats]
    """(seeds, len(grid)) accuracy at each ρ of the grid, a mean over all scanned settings of a
    problem, over its noisy ones and over its noise-free ones, for each seed."""
    clean: dict[Key, Floats]
    """(seeds, len(grid)), the same for the setting of the paper's statement (`CONDITIONS`)."""

    @cached_property
    def problems(self) -> tuple[str, ...]:
        """Problems that were scanned."""
        return tuple(problem for problem in PROBLEMS if any(problem == p for _, _, p in self.whole))

    def _keys(self, residual: str, solver: str) -> list[Key]:
        """Of all problems; those without the other unknown stand with the residual that they have."""
        other = "qr" if residual == "tan" else residual
        return [(residual if p == "3p1" else other, solver, p) for p in self.problems]

    def curves_by_seed(self, residual: str, problem: str, rule: Rule, solver: str) -> Floats:
        """The curve of each seed, (seeds, len(grid))."""
        if rule in RULES:
            mean: Floats = np.mean([self.whole[key] for key in self._keys(residual, solver)], axis=0)
            return mean
        return (self.own if rule == "own" else self.exact)[residual, solver, problem]

    def curve(self, residual: str, problem: str, rule: Rule, solver: str = SPARSE) -> Floats:
        """The curve (len(grid),) whose highest point decides, among those that meet the paper's statements."""
        mean: Floats = self.curves_by_seed(residual, problem, rule, solver).mean(axis=0)
        return mean

    def met(self, residual: str, solver: str = SPARSE) -> dict[str, Bools]:
        """Which ρ of the grid meet what the paper says of each problem."""
        return {key[2]: CONDITIONS[key[2]][1](self.clean[key].mean(axis=0)) for key in self._keys(residual, solver)}

    def choose_rho(self, residual: str, problem: str, rule: Rule, solver: str = SPARSE) -> float:
        """The ρ for a residual, a problem and a solver; with one ρ it is the same for all problems."""
        key = residual, problem, rule, solver
        if key not in self._chosen:  # asked for with every cell of every table
            stack = self._stack(*key)
            self._chosen[key] = self.effort.grid[int(self._best(stack.mean(axis=0), rule))]
        return self._chosen[key]

    @cached_property
    def _chosen(self) -> dict[tuple[str, str, Rule, str], float]:
        return {}

    def _stack(self, residual: str, problem: str, rule: Rule, solver: str) -> Floats:
        """For each seed the curve that decides, and what the conditions are tested on: (seeds, 1 + k, len(grid))."""
        tested = [self.clean[key] for key in self._keys(residual, solver)] if rule == "paper" else []
        return np.stack([self.curves_by_seed(residual, problem, rule, solver), *tested], axis=1)

    def _best(self, means: Floats, rule: Rule) -> Integers:
        """Index (…) of the ρ that means (…, 1 + k, len(grid)) choose: most conditions met, then accuracy, then size."""
        # Means of the same hits added up in another order must count as equal.
        curve, *tested = np.moveaxis(np.round(means, 9), -2, 0)
        if rule == "paper":
            met = [CONDITIONS[p][1](mean) for p, mean in zip(self.problems, tested, strict=True)]
            curve = curve + 2.0 * np.sum(met, axis=0)
        return np.asarray(np.argmax(curve, axis=-1))

    def choices(self, residual: str, problem: str, rule: Rule, solver: str = SPARSE) -> dict[float, float]:
        """Each ρ that is chosen on resampled seeds, and on what share of them, the most frequent first."""
        resampled = bootstrap_means(self._stack(residual, problem, rule, solver))
        found, counts = np.unique(self._best(resampled, rule), return_counts=True)
        shares = {self.effort.grid[k]: float(count) / len(resampled) for k, count in zip(found, counts, strict=True)}
        return dict(sorted(shares.items(), key=lambda item: -item[1]))


def choose(store: Store, effort: Effort, problems: tuple[str, ...] = PROBLEMS) -> Rhos:
    """Accuracies of a finished scan."""
    rhos = Rhos(effort, {}, {}, {}, {})
    for residual in RESIDUALS:
        for problem in problems:
            settings = scan_settings(residual, problem)
            for solver in SCAN_SOLVERS[:1] if residual == "tan" else SCAN_SOLVERS:
                if not settings:
                    continue
                key = residual, solver, problem
                by_setting = np.array([_accuracies(store, setting, effort, residual, solver) for setting in settings])
                noise_free = np.array([s.noise == 0.0 for s in settings])
                rhos.whole[key] = by_setting.mean(axis=0)
                rhos.own[key] = by_setting[~noise_free].mean(axis=0)
                rhos.exact[key] = by_setting[noise_free].mean(axis=0)
                rhos.clean[key] = by_setting[settings.index(CONDITIONS[problem][0])]
    return rhos


def _accuracies(store: Store, setting: Setting, effort: Effort, residual: str, solver: str) -> Floats:
    """Accuracy of each scanned seed at each ρ of the grid, (seeds, len(grid))."""
    seeds, size = effort.scan_seeds(residual), effort.scan_samples(residual)
    methods = [Method(residual_name(setting.problem, residual), solver, rho) for rho in effort.grid]
    found = [store.accuracies(setting, method, seeds)[size] for method in methods]
    return np.array([[by_seed[seed] for by_seed in found] for seed in seeds])

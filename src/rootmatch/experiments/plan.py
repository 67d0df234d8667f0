"""What is run on the reported scenes, once ρ is chosen, and the names by which figures and claims ask for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rootmatch.experiments.rho import RESIDUALS, RULES, Rhos, Rule
from rootmatch.experiments.settings import DEFAULT_PIPELINE, SAMPLES, Method, Setting, has_svd, settings_of
from rootmatch.experiments.store import Store
from rootmatch.experiments.sweep import Plan

SPARSE, BALANCED, DENSE = "power-l1", "power-l1-balanced", "power-dense"
"""The paper's two solvers, and between them the one that balances both sets, which is not the paper's."""

Improvement = Literal["balanced", "pipeline"]
IMPROVEMENT_NAMES: dict[Improvement, str] = {"balanced": "balanced solver", "pipeline": "default pipeline"}
"""What may stand in the place of the paper's sparse solver: another normalisation, or all that this library has."""

COMMON_SAMPLES = 100_000
"""The sample size at which all residuals are compared."""
MOST_SAMPLES = max(SAMPLES)


def plan_of(problems: tuple[str, ...], rhos: Rhos) -> Plan:
    """Methods and sample sizes on all settings of the problems' figures.

    The residual of the paper's figures and the default pipeline have whole curves. ``qr-both`` is compared at 10⁵
    samples; so is ``svd``, on the settings that have it. The balanced solver gets the tensors of the sparse one, its ρ
    included, so that nothing differs but the normalisation.
    """
    plan: Plan = {}
    # up2p, the cheapest, first: what all share is then compiled and kept on disk by the time that the others need it.
    for problem in reversed(problems):
        for setting in settings_of(problem):
            methods: dict[Method, tuple[int, ...]] = {}
            for rule in RULES:
                rho = {r: rhos.chosen(r, problem, rule) for r in RESIDUALS}
                for solver in (SPARSE, BALANCED, DENSE):
                    methods[Method("qr", solver, rho["qr"])] = SAMPLES
                for solver in (SPARSE, BALANCED):
                    methods[Method("qr-both", solver, rho["qr-both"])] = (COMMON_SAMPLES,)
                    if has_svd(setting):
                        methods[Method("svd", solver, rho["svd"])] = (COMMON_SAMPLES,)
            methods[DEFAULT_PIPELINE] = SAMPLES
            plan[setting] = tuple(methods.items())
    # Scenes with few outliers first, the problems in turn: progress is then a fair sample of the whole.
    return dict(sorted(plan.items(), key=lambda item: item[0].outliers))


@dataclass(frozen=True)
class Table:
    """Accuracies of all instances, by setting, method and sample size.

    Attributes
    ----------
    problems : tuple of str
        Those that were run.
    seeds : range
        Of the instances.
    rhos : Rhos
    cells : dict of (Setting, Method, samples) to (instances,) array
        Instances in the order of their seeds, so that cells can be paired.
    improvement : Improvement, optional
        What `paper` gives in the place of the paper's sparse solver, so that the same claims can be judged for it.
    """

    problems: tuple[str, ...]
    seeds: range
    rhos: Rhos
    cells: dict[tuple[Setting, Method, int], NDArray[np.float64]]
    improvement: Improvement | None = None

    @classmethod
    def read(cls, store: Store, problems: tuple[str, ...], rhos: Rhos, seeds: range) -> Table:
        """All accuracies of a finished sweep."""
        cells = {}
        for setting, methods in plan_of(problems, rhos).items():
            for method, sizes in methods:
                found = store.accuracies(setting, method, seeds)
                for size in sizes:
                    cells[setting, method, size] = np.array([found[size][seed] for seed in seeds])
        return cls(problems, seeds, rhos, cells)

    def method(self, problem: str, solver: str = SPARSE, rule: Rule = "one", residual: str = "qr") -> Method:
        """The paper's method with a chosen ρ."""
        return Method(residual, solver, self.rhos.chosen(residual, problem, rule))

    def paper(
        self,
        setting: Setting,
        solver: str = SPARSE,
        rule: Rule = "one",
        samples: int = MOST_SAMPLES,
        residual: str = "qr",
    ) -> NDArray[np.float64]:
        """Accuracies (instances,) of the paper's method, or of the improvement in the place of its sparse solver."""
        if solver == SPARSE and self.improvement == "pipeline":
            return self.default(setting, samples)
        if solver == SPARSE and self.improvement == "balanced":
            solver = BALANCED
        return self.cells[setting, self.method(setting.problem, solver, rule, residual), samples]

    def default(self, setting: Setting, samples: int = MOST_SAMPLES) -> NDArray[np.float64]:
        """Accuracies (instances,) of the default pipeline."""
        return self.cells[setting, DEFAULT_PIPELINE, samples]

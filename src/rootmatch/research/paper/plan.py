"""Runs on the reported scenes once ρ is chosen, and the names by which figures and claims refer to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rootmatch.arrays import Floats
from rootmatch.research.paper.rho import RULES, SPARSE, START, Rhos, Rule
from rootmatch.research.paper.settings import (
    DEFAULT_PIPELINE,
    Effort,
    Method,
    Setting,
    has_svd,
    problem_settings,
    residual_name,
)
from rootmatch.research.sweep import Plan

DENSE, DENSE_START = "power-dense", "power-dense-start"
BALANCED = "power-l1-balanced"

Variant = Literal["text", "published", "tan", "balanced", "pipeline"]
VARIANT_NAMES: dict[Variant, str] = {
    "text": "solver of the text",
    "published": "published solver",
    "tan": "3P1 by tan(θ/2)",
    "balanced": "balanced solver",
    "pipeline": "default pipeline",
}
"""The paper's method with the solver of its text, or with one thing replaced: by the solver of the published code, by
the other unknown of 3P1, by another normalisation; or all that this library has."""

_SOLVERS: dict[Variant, dict[str, str]] = {
    "published": {SPARSE: START, DENSE: DENSE_START},
    "balanced": {SPARSE: BALANCED},
}


def make_plan(problems: tuple[str, ...], rhos: Rhos) -> Plan:
    """Methods and sample sizes on all settings of the problems' figures.

    The residual of the paper's figures, with either unknown of 3P1, and the default pipeline have whole curves, the
    other residuals one sample size each; ``svd`` is run on the settings that have it. The balanced solver gets the
    tensors of the sparse one, its ρ included, so that nothing differs but the normalisation.
    """
    plan: Plan = {}
    effort, end = rhos.effort, (rhos.effort.maximum,)
    # up2p, the cheapest, first: what all share is then compiled and kept on disk by the time that the others need it.
    for problem in reversed(problems):
        for setting in problem_settings(problem):
            asked: list[tuple[str, str, Rule, tuple[int, ...]]] = []
            for rule in RULES:
                asked += [("qr", how, rule, effort.samples) for how in (SPARSE, START, BALANCED, DENSE, DENSE_START)]
                for residual in ("qr-both", "svd") if has_svd(setting) else ("qr-both",):
                    asked += [(residual, how, rule, (effort.common,)) for how in (SPARSE, START, BALANCED)]
                if problem == "3p1":
                    asked.append(("tan", SPARSE, rule, effort.samples))
            for how in (SPARSE, START, BALANCED):
                asked += [("qr", how, "own", end), ("qr", how, "exact", end)]
            sizes: dict[Method, tuple[int, ...]] = {}
            for residual, how, rule, wanted in asked:
                method = paper_method(rhos, problem, how, rule, residual)
                sizes[method] = tuple(sorted({*sizes.get(method, ()), *wanted}))
            sizes[DEFAULT_PIPELINE] = effort.samples
            plan[setting] = tuple(sizes.items())
    # Scenes with few outliers first, the problems in turn: progress is then a fair sample of the whole.
    return dict(sorted(plan.items(), key=lambda item: item[0].outliers))


def paper_method(rhos: Rhos, problem: str, solver: str, rule: Rule, residual: str = "qr") -> Method:
    """The paper's method with the ρ that a rule chooses for its solver."""
    scanned = START if solver in (START, DENSE_START) else SPARSE
    return Method(residual_name(problem, residual), solver, rhos.choose_rho(residual, problem, rule, scanned))


@dataclass(frozen=True)
class Table:
    """Accuracies of all instances, by setting, method and sample size."""

    problems: tuple[str, ...]
    """Those that were run."""
    seeds: range
    """Of the instances."""
    rhos: Rhos
    cells: dict[tuple[Setting, Method, int], Floats]
    """(instances,) of each setting, method and sample size, in the order of their seeds, so that cells
    can be paired."""
    variant: Variant = "text"
    """Which reading of the paper's method, or what in its place, `paper` gives: the same claims are judged for each."""

    @property
    def effort(self) -> Effort:
        """How much was run."""
        return self.rhos.effort

    def method(self, problem: str, solver: str = SPARSE, rule: Rule = "paper", residual: str = "qr") -> Method:
        """The variant's method with a chosen ρ."""
        if self.variant == "pipeline" and solver == SPARSE:
            return DEFAULT_PIPELINE
        if self.variant == "tan" and residual == "qr" and solver == SPARSE:
            residual = "tan"
        solver = _SOLVERS.get(self.variant, {}).get(solver, solver)
        return paper_method(self.rhos, problem, solver, rule, residual)

    def paper(
        self,
        setting: Setting,
        solver: str = SPARSE,
        rule: Rule = "paper",
        samples: int | None = None,
        residual: str = "qr",
    ) -> Floats:
        """Accuracies (instances,) of the variant's method, at the largest sample unless another is given."""
        return self.cells[setting, self.method(setting.problem, solver, rule, residual), samples or self.effort.maximum]

    def default(self, setting: Setting) -> Floats:
        """Accuracies (instances,) of the default pipeline at the largest sample."""
        return self.cells[setting, DEFAULT_PIPELINE, self.effort.maximum]

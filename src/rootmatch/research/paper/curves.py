"""Mean accuracy against the number of sampled hyper-edges, and the scan of ρ, as CSV files."""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.research.bootstrap import estimates
from rootmatch.research.output_files import csv_text
from rootmatch.research.paper.plan import Table, make_plan, paper_method
from rootmatch.research.paper.rho import ALL_RULES, RESIDUALS, RULES, Rhos, Rule
from rootmatch.research.paper.settings import DEFAULT_PIPELINE, PANELS, Method, residual_name

HEADER = (
    "panel", "problem", "outliers", "noise_px", "baseline", "motions", "residual", "solver", "rho", "rho_rule",
    "samples", "instances", "accuracy", "low", "high",
)  # fmt: skip
"""Columns of the curves. Noise is in pixels, accuracies lie from 0 to 1."""


def choosing_rules(table: Table, problem: str, method: Method) -> list[Rule | None]:
    """By which rules the ρ of a method was chosen; several if they agree, none for the default pipeline."""
    if method == DEFAULT_PIPELINE:
        return [None]
    asked = [(residual, rule) for residual in RESIDUALS for rule in ALL_RULES if residual != "tan" or problem == "3p1"]
    same = [rule for residual, rule in asked if _is_chosen(table, problem, method, residual, rule)]
    return list(dict.fromkeys(same))


def _is_chosen(table: Table, problem: str, method: Method, residual: str, rule: Rule) -> bool:
    """Whether a rule gives a method its ρ."""
    if residual_name(problem, residual) != method.residual:
        return False
    return paper_method(table.rhos, problem, method.solver, rule, residual) == method


def curves_csv(table: Table, problem: str) -> str:
    """All points of all curves of a problem's figure, in the order of its panels, as CSV text with a header."""
    plan = make_plan((problem,), table.rhos)
    rows = []
    for panel in PANELS[problem]:
        for s in panel.settings:
            where = (panel.label, s.problem, s.outliers, s.noise, s.baseline, s.motions)
            for m, sizes in plan[s]:
                columns = np.stack([table.cells[s, m, size] for size in sizes], axis=1)
                rules = choosing_rules(table, problem, m)
                for size, e in zip(sizes, estimates(columns), strict=True):
                    figures = (size, e.count, *(round(value, 6) for value in (e.mean, e.low, e.high)))
                    rows += [(*where, m.residual, m.solver, m.rho, rule or "", *figures) for rule in rules]
    return csv_text(HEADER, rows)


def scan_csv(rhos: Rhos) -> str:
    """The scan of ρ as CSV text: mean accuracy of both sparse solvers at each ρ of the grid."""
    rows: list[tuple[Any, ...]] = []
    for residual, solver in dict.fromkeys((residual, solver) for residual, solver, _ in rhos.whole):
        for rule in ALL_RULES:
            scanned = [p for p in rhos.problems if (residual, solver, p) in rhos.whole]
            for problem in scanned[:1] if rule in RULES else scanned:
                asked = residual, problem, rule, solver
                chosen, curve = rhos.choose_rho(*asked), rhos.curve(*asked)
                name, samples = "all" if rule in RULES else problem, rhos.effort.scan_samples(residual)
                for rho, mean in zip(rhos.effort.grid, curve, strict=True):
                    rows.append((residual, name, rule, solver, samples, rho, round(mean, 6), int(rho == chosen)))
    return csv_text(("residual", "problem", "rho_rule", "solver", "samples", "rho", "accuracy", "chosen"), rows)

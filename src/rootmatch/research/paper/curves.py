"""Mean accuracy against the number of sampled hyper-edges: tidy records, and their CSV files."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, fields

import numpy as np

from rootmatch.research.paper.plan import Table, method_of, plan_of
from rootmatch.research.paper.rho import ALL_RULES, RESIDUALS, RULES, Rhos, Rule
from rootmatch.research.paper.settings import DEFAULT_PIPELINE, PANELS, Method, Setting, residual_of
from rootmatch.research.statistics import estimates


@dataclass(frozen=True)
class Record:
    """One point of a curve: a line of the CSV file. Noise is in pixels, accuracies lie from 0 to 1."""

    panel: str
    problem: str
    outliers: int
    noise_px: float
    baseline: float
    motions: int
    residual: str
    solver: str
    rho: float
    rho_rule: str
    samples: int
    instances: int
    accuracy: float
    low: float
    high: float


def rules_of(table: Table, problem: str, method: Method) -> list[Rule | None]:
    """By which rules the ρ of a method was chosen; several if they agree, none for the default pipeline."""
    if method == DEFAULT_PIPELINE:
        return [None]
    asked = [(residual, rule) for residual in RESIDUALS for rule in ALL_RULES if residual != "tan" or problem == "3p1"]
    same = [rule for residual, rule in asked if _is_chosen(table, problem, method, residual, rule)]
    return list(dict.fromkeys(same))


def _is_chosen(table: Table, problem: str, method: Method, residual: str, rule: Rule) -> bool:
    """Whether a rule gives a method its ρ."""
    if residual_of(problem, residual) != method.residual:
        return False
    return method_of(table.rhos, problem, method.solver, rule, residual) == method


def records(table: Table, problem: str) -> list[Record]:
    """All points of all curves of a problem's figure, in the order of its panels."""
    plan = plan_of((problem,), table.rhos)
    found = []
    for panel in PANELS[problem]:
        for setting in panel.settings:
            for method, sizes in plan[setting]:
                columns = np.stack([table.cells[setting, method, size] for size in sizes], axis=1)
                for size, e in zip(sizes, estimates(columns), strict=True):
                    for rule in rules_of(table, problem, method):
                        found.append(
                            _record(
                                panel=panel.label,
                                s=setting,
                                m=method,
                                rule=rule,
                                samples=size,
                                count=e.count,
                                mean=e.mean,
                                low=e.low,
                                high=e.high,
                            )
                        )
    return found


def _record(
    panel: str,
    s: Setting,
    m: Method,
    rule: Rule | None,
    samples: int,
    count: int,
    mean: float,
    low: float,
    high: float,
) -> Record:
    where = (panel, s.problem, s.outliers, s.noise, s.baseline, s.motions)
    how = (m.residual, m.solver, m.rho, rule or "")
    return Record(*where, *how, samples, count, *(round(value, 6) for value in (mean, low, high)))


def curves_csv(table: Table, problem: str) -> str:
    """The records of a problem as CSV text with a header."""
    out = io.StringIO()
    names = [field.name for field in fields(Record)]
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([[getattr(record, name) for name in names] for record in records(table, problem)])
    return out.getvalue()


def scan_csv(rhos: Rhos) -> str:
    """The scan of ρ as CSV text: mean accuracy of both sparse solvers at each ρ of the grid."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["residual", "problem", "rho_rule", "solver", "samples", "rho", "accuracy", "chosen"])
    for residual, solver in dict.fromkeys((residual, solver) for residual, solver, _ in rhos.whole):
        for rule in ALL_RULES:
            scanned = [p for p in rhos.problems if (residual, solver, p) in rhos.whole]
            for problem in scanned[:1] if rule in RULES else scanned:
                asked = residual, problem, rule, solver
                chosen, curve = rhos.chosen(*asked), rhos.curve(*asked)
                name, samples = "all" if rule in RULES else problem, rhos.effort.scan_samples(residual)
                for rho, mean in zip(rhos.effort.grid, curve, strict=True):
                    writer.writerow((residual, name, rule, solver, samples, rho, round(mean, 6), int(rho == chosen)))
    return out.getvalue()

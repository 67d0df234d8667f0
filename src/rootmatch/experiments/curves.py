"""Mean accuracy against the number of sampled hyper-edges: tidy records, and their CSV files."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, fields

import numpy as np

from rootmatch.experiments.plan import SPARSE, Table, plan_of
from rootmatch.experiments.rho import GRID, RESIDUALS, RULES, SCAN_SAMPLES, Rhos, Rule
from rootmatch.experiments.settings import DEFAULT_PIPELINE, PANELS, Method, Setting
from rootmatch.experiments.statistics import estimates


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


def rule_of(table: Table, problem: str, method: Method) -> list[Rule | None]:
    """Rule by which the ρ of a method was chosen; several if they agree, none for the default pipeline."""
    if method == DEFAULT_PIPELINE:
        return [None]
    return [rule for rule in RULES if table.method(problem, method.solver, rule, method.residual) == method]


def records(table: Table, problem: str) -> list[Record]:
    """All points of all curves of a problem's figure, in the order of its panels."""
    plan = plan_of((problem,), table.rhos)
    found = []
    for panel in PANELS[problem]:
        for setting in panel.settings:
            for method, sizes in plan[setting]:
                columns = np.stack([table.cells[setting, method, size] for size in sizes], axis=1)
                for size, e in zip(sizes, estimates(columns), strict=True):
                    for rule in rule_of(table, problem, method):
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
    """The scan of ρ as CSV text: mean accuracy of the sparse solver at each ρ of the grid."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["residual", "problem", "rho_rule", "solver", "samples", "rho", "accuracy", "chosen"])
    for residual in RESIDUALS:
        for rule in RULES:
            for problem in ("all",) if rule == "one" else rhos.problems:
                chosen, curve = rhos.chosen(residual, problem, rule), rhos.curve(residual, problem, rule)
                for rho, mean in zip(GRID, curve, strict=True):
                    values = (residual, problem, rule, SPARSE, SCAN_SAMPLES, rho, round(mean, 6), int(rho == chosen))
                    writer.writerow(values)
    return out.getvalue()

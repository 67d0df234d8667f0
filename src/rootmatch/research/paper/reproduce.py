"""The paper's experiments from scenes to figures and claims, in one call that resumes where it stopped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.errors import InputError
from rootmatch.io.csv_tables import csv_text
from rootmatch.research.bootstrap import estimates
from rootmatch.research.output_files import count_text, figure_files, write_files
from rootmatch.research.paper.claims_report import claims_markdown
from rootmatch.research.paper.figures import FIGURES, draw, draw_scan
from rootmatch.research.paper.plan import Table, Variant, make_plan, paper_method
from rootmatch.research.paper.rho import ALL_RULES, RESIDUALS, RULES, Rhos, Rule, choose, scan_plan
from rootmatch.research.paper.settings import (
    DEFAULT_PIPELINE,
    PANELS,
    PROBLEMS,
    SCAN_SEED,
    Effort,
    Method,
    residual_name,
)
from rootmatch.research.paper.work_unit import evaluate
from rootmatch.research.store import Store
from rootmatch.research.sweep import Evaluate, Stage, accuracies, check_jobs, complete, units

STORE_NAME = "results.sqlite"

HEADER = (
    "panel", "problem", "outliers", "noise_px", "baseline", "motions", "residual", "solver", "rho", "rho_rule",
    "samples", "instances", "accuracy", "low", "high",
)  # fmt: skip
"""Columns of the curves. Noise is in pixels, accuracies lie from 0 to 1."""


def reproduce(
    problems: tuple[str, ...],
    output: Path,
    *,
    effort: Effort | None = None,
    seed: int = 0,
    jobs: int = -1,
    scheduler: str | None = None,
    progress: Stage | None = None,
    function: Evaluate = evaluate,
) -> tuple[Path, ...]:
    """Run what is missing of the experiments, draw the figures and judge the claims; the files that are written.

    Parameters
    ----------
    problems : tuple of str
        Of ``"p3p"``, ``"3p1"``, ``"up2p"``. Those that the folder has already are run with them, as the one ρ is chosen
        over all.
    output : Path
        Folder of ``results.sqlite``, the figures (PNG and SVG), the curves (CSV) and ``claims.md``. The same call on
        the same folder goes on where an earlier one stopped; more instances or problems add to what is there.
    effort : Effort, optional
        How much is run; a hundred scenes of each setting by default.
    seed : int
        Of the first scene; the others follow.
    jobs, scheduler, progress, function
        See `rootmatch.research.sweep.run`.

    Raises
    ------
    InputError
        For an unknown problem, counts out of range, a store that cannot be used or a scheduler that does not answer.
    """
    unknown = [problem for problem in problems if problem not in PROBLEMS]
    if unknown or not problems:
        raise InputError(f"problem: {', '.join(unknown) or 'none'} given; one of {', '.join(PROBLEMS)} expected")
    effort = effort or Effort()
    instances = effort.instances
    if instances < 1 or seed < 0 or seed + instances > SCAN_SEED:
        raise InputError(
            f"{instances} instances from seed {seed}: give at least one, with seeds from 0 to {SCAN_SEED - 1:,}; "
            "higher seeds are reserved for choosing ρ"
        )
    check_jobs(jobs)
    seeds = range(seed, seed + instances)
    how: dict[str, Any] = {"jobs": jobs, "scheduler": scheduler, "progress": progress, "function": function}
    with Store(output / STORE_NAME) as store:
        # the files are of all that the folder has: another problem may change the one ρ of the first
        ordered = tuple(p for p in PROBLEMS if p in problems or _is_scanned(p, store, effort))
        for residual in RESIDUALS:
            scan = scan_plan(residual, effort, ordered)
            complete(f"choosing ρ for {residual}", scan, effort.scan_seeds(residual), store, **how)
        rhos = choose(store, effort, ordered)
        title = f"{', '.join(ordered)}: {count_text(instances, 'instance')}"
        plan = make_plan(ordered, rhos)
        complete(title, plan, seeds, store, **how)
        table = Table(ordered, seeds, rhos, accuracies(plan, seeds, store))
        return write(table, output, claims_markdown(table, store.versions(), store.seconds()))


def _is_scanned(problem: str, store: Store, effort: Effort) -> bool:
    """Whether a store holds the whole scan of a problem."""
    return not any(
        units(scan_plan(residual, effort, (problem,)), effort.scan_seeds(residual), store) for residual in RESIDUALS
    )


def write(table: Table, output: Path, claims: str) -> tuple[Path, ...]:
    """Write figures, curves and claims; a file that is being replaced stays whole until the new one is."""
    return write_files(output, _files(table, claims))


def _files(table: Table, claims: str) -> Iterator[tuple[str, bytes]]:
    """Names and contents of all files."""
    published = replace(table, variant="published")
    yield from figure_files("rho-scan", draw_scan(table.rhos))
    for problem in table.problems:
        stem = f"figure-{FIGURES[problem]}-{problem}"
        drawings: dict[str, tuple[Table, Rule, Variant | None]] = {
            "": (table, "paper", None),
            "-free-rho": (table, "one", None),
            "-published": (published, "paper", None),
            "-published-free-rho": (published, "one", None),
            **({"-tan": (table, "paper", "tan")} if problem == "3p1" else {}),
            "-balanced": (table, "paper", "balanced"),
            "-default-pipeline": (table, "paper", "pipeline"),
        }
        for name, (drawn, rule, beside) in drawings.items():
            yield from figure_files(stem + name, draw(drawn, problem, rule, beside))
    for problem in table.problems:
        yield f"figure-{FIGURES[problem]}-{problem}.csv", curves_csv(table, problem).encode()
    yield "rho-scan.csv", scan_csv(table.rhos).encode()
    yield "claims.md", claims.encode()


def choosing_rules(table: Table, problem: str, method: Method) -> list[Rule | None]:
    """By which rules the ρ of a method was chosen; several if they agree, none for the default pipeline."""
    if method == DEFAULT_PIPELINE:
        return [None]
    asked = [(residual, rule) for residual in RESIDUALS for rule in ALL_RULES if residual != "tan" or problem == "3p1"]
    same = [
        rule
        for residual, rule in asked
        if residual_name(problem, residual) == method.residual
        and paper_method(table.rhos, problem, method.solver, rule, residual) == method
    ]
    return list(dict.fromkeys(same))


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
    return csv_text([HEADER, *rows])


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
    header = ("residual", "problem", "rho_rule", "solver", "samples", "rho", "accuracy", "chosen")
    return csv_text([header, *rows])

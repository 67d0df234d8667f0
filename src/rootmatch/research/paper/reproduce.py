"""The paper's experiments from scenes to figures and claims, in one call that resumes where it stopped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from rootmatch.errors import InputError
from rootmatch.research.output_files import figure_files, write_files
from rootmatch.research.paper.claims_report import claims_markdown
from rootmatch.research.paper.curves import curves_csv, scan_csv
from rootmatch.research.paper.figures import FIGURES, draw, draw_scan
from rootmatch.research.paper.plan import Table, Variant, make_plan
from rootmatch.research.paper.rho import RESIDUALS, Rule, choose, scan_plan
from rootmatch.research.paper.settings import PROBLEMS, SCAN_SEED, Effort
from rootmatch.research.paper.work_unit import evaluate
from rootmatch.research.store import Store
from rootmatch.research.sweep import Evaluate, Stage, accuracies, check_jobs, complete, units

STORE_NAME = "results.sqlite"


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
        Of ``"p3p"``, ``"3p1"``, ``"up2p"``. The one ρ is chosen over these, and over what the folder has scanned whole.
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
    ordered = tuple(problem for problem in PROBLEMS if problem in problems)
    seeds = range(seed, seed + instances)
    how: dict[str, Any] = {"jobs": jobs, "scheduler": scheduler, "progress": progress, "function": function}
    with Store(output / STORE_NAME) as store:
        scanned = tuple(p for p in PROBLEMS if p in ordered or _is_scanned(p, store, effort))
        for residual in RESIDUALS:
            scan = scan_plan(residual, effort, scanned)
            complete(f"choosing ρ for {residual}", scan, effort.scan_seeds(residual), store, **how)
        rhos = choose(store, effort, scanned)
        title = f"{', '.join(ordered)}: {instances} instances"
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

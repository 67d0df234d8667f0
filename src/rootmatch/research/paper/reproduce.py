"""The paper's experiments from scenes to figures and claims, in one call that resumes where it stopped."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from rootmatch.errors import InputError
from rootmatch.io import written_whole
from rootmatch.research.figure_files import contents
from rootmatch.research.paper.claims_report import claims_markdown
from rootmatch.research.paper.curves import curves_csv, scan_csv
from rootmatch.research.paper.figures import FIGURES, draw, draw_scan
from rootmatch.research.paper.plan import Table, plan_of
from rootmatch.research.paper.rho import RESIDUALS, Rhos, choose, scan_plan
from rootmatch.research.paper.settings import PROBLEMS, SCAN_SEED, Effort
from rootmatch.research.paper.unit import evaluate
from rootmatch.research.progress import Progress
from rootmatch.research.store import Store
from rootmatch.research.sweep import Evaluate, Plan, check_jobs, run, units

STORE_NAME = "results.sqlite"


@dataclass(frozen=True)
class Reproduction:
    """The files that were written, and the chosen ρ."""

    files: tuple[Path, ...]
    rhos: Rhos


def reproduce(
    problems: tuple[str, ...],
    output: Path,
    *,
    effort: Effort | None = None,
    seed: int = 0,
    jobs: int = -1,
    scheduler: str | None = None,
    progress: Progress | None = None,
    function: Evaluate = evaluate,
) -> Reproduction:
    """Run what is missing of the experiments, then draw the figures and judge the claims.

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
    with Store(output / STORE_NAME) as store:

        def complete(title: str, plan: Plan, stage_seeds: range) -> None:
            work = units(plan, stage_seeds, store)
            if progress is not None and work:
                progress.begin(title, sum(unit.rows for unit in work))
            run(work, store, jobs=jobs, scheduler=scheduler, progress=progress, function=function)

        scanned = tuple(p for p in PROBLEMS if p in ordered or _is_scanned(p, store, effort))
        for residual in RESIDUALS:
            complete(f"choosing ρ for {residual}", scan_plan(residual, effort, scanned), effort.scan_seeds(residual))
        rhos = choose(store, effort, scanned)
        complete(f"{', '.join(ordered)}: {instances} instances", plan_of(ordered, rhos), seeds)
        table = Table.read(store, ordered, rhos, seeds)
        files = write(table, output, claims_markdown(table, store.versions(), store.seconds()))
    return Reproduction(files, rhos)


def _is_scanned(problem: str, store: Store, effort: Effort) -> bool:
    """Whether a store holds the whole scan of a problem."""
    return not any(
        units(scan_plan(residual, effort, (problem,)), effort.scan_seeds(residual), store) for residual in RESIDUALS
    )


def write(table: Table, output: Path, claims: str) -> tuple[Path, ...]:
    """Write figures, curves and claims; a file that is being replaced stays whole until the new one is."""
    files: list[Path] = []

    def add(name: str, content: bytes) -> None:
        with written_whole(output / name) as temporary:
            temporary.write_bytes(content)
        files.append(output / name)

    drawings = {"rho-scan": draw_scan(table.rhos)}
    for problem in table.problems:
        stem = f"figure-{FIGURES[problem]}-{problem}"
        published = replace(table, variant="published")
        drawings[stem] = draw(table, problem, "paper")
        drawings[f"{stem}-free-rho"] = draw(table, problem, "one")
        drawings[f"{stem}-published"] = draw(published, problem, "paper")
        drawings[f"{stem}-published-free-rho"] = draw(published, problem, "one")
        if problem == "3p1":
            drawings[f"{stem}-tan"] = draw(table, problem, "paper", "tan")
        drawings[f"{stem}-balanced"] = draw(table, problem, "paper", "balanced")
        drawings[f"{stem}-default-pipeline"] = draw(table, problem, "paper", "pipeline")
    for stem, figure in drawings.items():
        for kind, content in contents(figure):
            add(f"{stem}.{kind}", content)
    for problem in table.problems:
        add(f"figure-{FIGURES[problem]}-{problem}.csv", curves_csv(table, problem).encode())
    add("rho-scan.csv", scan_csv(table.rhos).encode())
    add("claims.md", claims.encode())
    return tuple(files)

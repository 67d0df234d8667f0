"""The command ``rootmatch reproduce``: the paper's experiments, figures and claims, and the public protocols."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from rootmatch.cli.surroundings import note_remainder


def reproduce(
    which: Annotated[
        Literal["p3p", "3p1", "up2p", "all", "hypergraph"],
        typer.Argument(help="One problem of the paper, all of them, or the public protocols of hypergraph matching."),
    ],
    output: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the results; an interrupted run resumes.")],
    instances: Annotated[
        int | None, typer.Option(metavar="N", help="Scenes per setting; 100 by default, 4 with --quick.")
    ] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Every figure and claim in five minutes: few scenes, no more than 10^5 samples."),
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the first scene.")] = 0,
    jobs: Annotated[int, typer.Option(metavar="N", help="Processes; -1 for one per processor.")] = -1,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on the workers of a Dask scheduler, tcp://HOST:PORT.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Run the paper's experiments, draw its figures and check its claims.

    With `hypergraph`, all solvers run on the public protocols of hypergraph matching instead.

    Results are stored as they arrive: after any interruption the same command resumes. The same seed gives the same
    results whatever the number of processes. A hundred scenes per setting take hours on one core (`hypergraph`: about
    six minutes); `--quick` takes five minutes on two cores.

    Exit code 0: done; 2: bad input; 130: interrupted, finished work is kept.
    """
    from rootmatch.cli.progress import progress_bar
    from rootmatch.research.hypergraph.run import reproduce as run_protocols
    from rootmatch.research.paper.reproduce import reproduce as run
    from rootmatch.research.paper.settings import PROBLEMS, Effort

    note_remainder("finished work is kept, and the same command continues")
    progress = partial(progress_bar, wanted=not quiet)
    how: dict[str, Any] = {"seed": seed, "jobs": jobs, "scheduler": scheduler, "progress": progress}
    if which == "hypergraph":
        files = run_protocols(output, instances=(10 if quick else 100) if instances is None else instances, **how)
    else:
        effort = Effort((4 if quick else 100) if instances is None else instances, quick)
        files = run(PROBLEMS if which == "all" else (which,), output, effort=effort, **how)
    for path in files:
        typer.echo(path)

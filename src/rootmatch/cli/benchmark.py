"""The command ``rootmatch benchmark``: speed and memory on this machine."""

from __future__ import annotations

from functools import partial
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rootmatch.cli.surroundings import note_remainder, render_text
from rootmatch.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from rootmatch.research.speed import Results


def benchmark(
    what: Annotated[
        Literal["speed", "real", "blind"],
        typer.Argument(
            help="This machine's speed and memory, methods on real targets with ground truth, or on blind PnP "
            "(simultaneous pose and correspondence)."
        ),
    ] = "speed",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")] = False,
    tiny: Annotated[
        bool, typer.Option("--tiny", help="Smallest sizes: checks that everything runs, not how fast.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
    data: Annotated[Path | None, typer.Option(help="real, blind: folder of the data sets (.npz).")] = None,
    output: Annotated[
        Path | None, typer.Option(help="real, blind: folder for rows and tables; an interrupted run resumes.")
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="real: rootmatch, rootmatch-paper, or the command of a program that reads a line of JSON and answers "
            "with one; by default the first two. blind: a method of the table, by default all. May be repeated."
        ),
    ] = None,
    protocol: Annotated[list[str] | None, typer.Option(help="real, blind: only these scenes; may be repeated.")] = None,
    timeout: Annotated[
        float | None, typer.Option(help="Seconds for a scene; real: of the reply (60), blind: of processor time (10).")
    ] = None,
    scenes: Annotated[int, typer.Option(metavar="N", help="blind: scenes per row.")] = 20,
    first_seed: Annotated[int, typer.Option(metavar="S", help="blind: seed of the first scene.")] = 20_000,
    peer: Annotated[
        Path | None, typer.Option(metavar="FILE", help="blind: a Python file with a function ransac_match.")
    ] = None,
) -> None:
    """Measure speed and memory on this machine, or methods on real targets or blind PnP.

    Kernels are compared with batched numpy.linalg.qr of the same problem's matrices in the same run. The first run
    compiles, which takes minutes and is not timed; later runs take about a minute on two cores.
    """
    from rootmatch.cli.progress import progress_bar

    if what == "blind":
        from rootmatch.research.blind.run import run_blind

        if output is None:
            raise InputError("benchmark blind: give --output, the folder of rows and tables")
        note_remainder("the rows so far are kept, and the same command continues")
        with progress_bar("scenes", not quiet) as show:
            found = run_blind(
                output,
                scenes=scenes,
                first_seed=first_seed,
                seconds=10.0 if timeout is None else timeout,
                data=data,
                peer=peer,
                only=protocol,
                only_methods=method,
                tiny=tiny,
                progress=show,
            )
        typer.echo(dumps(found) if json else "\n".join(" | ".join(line) for line in found))
        return
    if what == "real":
        from rootmatch.research.real.leaderboard import leaderboard_page
        from rootmatch.research.real.methods import METHODS
        from rootmatch.research.real.run import run_real

        if data is None or output is None:
            raise InputError("benchmark real: give --data, the folder of the data sets, and --output")
        note_remainder("the rows so far are kept, and the same command continues")
        with progress_bar("scenes", not quiet) as show:
            table = run_real(
                data, output, method or list(METHODS), only=protocol, timeout=timeout or 60.0, progress=show
            )
        typer.echo(dumps(table, allow_nan=False) if json else leaderboard_page(table), nl=json)
        return
    from rootmatch.research.speed import Plan, run

    with progress_bar("benchmark", not quiet) as progress:
        results = run(Plan.tiny() if tiny else Plan(), progress)
    if json:
        from dataclasses import asdict

        typer.echo(dumps(asdict(results), allow_nan=False))
    else:
        typer.echo(render_text(partial(_print, results)), nl=False)


def _print(results: Results, console: Console) -> None:
    """Print the tables on a console."""
    from rich.table import Table

    console.print(f"rootmatch {results.version}, {results.machine}, {results.threads} threads")
    console.print(results.note)
    console.print(f"peak {results.peak_operations / 1e9:.3g} G floating-point operations/s in float64")
    columns = "problem", "residual", "M hyper-edges/s", "M QR/s", "ratio", "operations", "of peak"
    table = Table(*columns, title="Kernels, exhaustive, against numpy.linalg.qr")
    for row in results.kernels:
        share = row["share_of_peak"]  # above 1 where the peak was measured too briefly
        shown = f"{100 * share:.0f} %" if share <= 1.0 else "–"
        cells = (
            row["problem"], row["kind"], f"{row['per_second'] / 1e6:.1f}", f"{row['qr_per_second'] / 1e6:.2f}",
            f"{row['ratio']:.0f}", f"{row['operations']:.0f}", shown,
        )  # fmt: skip
        table.add_row(*cells)
    console.print(table)
    table = Table("match", "scenes", "median ms", "accuracy", "evaluations", title="Whole matches")
    for row in results.matches:
        figures = f"{row['milliseconds']:.1f}", f"{row['accuracy']:.3f}", f"{row['evaluations']:.3g}"
        table.add_row(row["case"], str(row["scenes"]), *figures)
    console.print(table)
    times = results.contraction
    console.print(
        f"contraction of {times['hyperedges']:.3g} hyper-edges: {times['milliseconds']:.2f} ms, one thread "
        f"{times['milliseconds_one_thread']:.2f} ms; numpy.add.at {times['milliseconds_add_at']:.0f} ms, "
        f"{times['ratio']:.0f} times slower"
    )
    memory = results.memory
    peak = "unknown on this system" if memory["peak_megabytes"] is None else f"{memory['peak_megabytes']:.0f} MiB"
    console.print(
        f"{memory['case']}: {memory['hyperedges'] / 1e6:.3g} M hyper-edges, {memory['kept']} kept at "
        f"{memory['bytes_each']:.0f} bytes; peak memory {peak}"
    )

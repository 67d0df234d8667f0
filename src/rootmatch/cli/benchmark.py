"""The command ``rootmatch benchmark``: what this machine does in a second."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rootmatch.benchmark import Results


def benchmark(
    json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
    tiny: Annotated[bool, typer.Option("--tiny", help="The least sizes: shows that all works, not how fast.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Measure kernels, contraction, whole matches and memory on this machine.

    Kernels are set against batched numpy.linalg.qr of the same problem's matrices in the same run. The first run
    compiles, which takes minutes and is not timed; after that it takes about a minute of two cores.
    """
    from rootmatch.benchmark import Plan, run
    from rootmatch.cli.progress import shown

    with shown("benchmark", not quiet) as progress:
        results = run(Plan.tiny() if tiny else Plan(), progress)
    if json:
        from dataclasses import asdict
        from json import dumps

        typer.echo(dumps(asdict(results), allow_nan=False))
    else:
        _show(results)


def _show(results: Results) -> None:
    """Tables on standard output."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(f"rootmatch {results.version}, {results.machine}, {results.threads} threads")
    console.print(results.note)
    console.print(f"peak {results.peak_operations / 1e9:.0f} G floating-point operations/s in float64")
    columns = "problem", "residual", "M hyper-edges/s", "M QR/s", "ratio", "operations", "of peak"
    table = Table(*columns, title="Kernels, exhaustive, beside numpy.linalg.qr")
    for row in results.kernels:
        table.add_row(
            row["problem"], row["kind"], f"{row['per_second'] / 1e6:.1f}", f"{row['qr_per_second'] / 1e6:.2f}",
            f"{row['ratio']:.0f}", f"{row['operations']:.0f}", f"{100 * row['share_of_peak']:.0f} %",
        )  # fmt: skip
    console.print(table)
    table = Table("match", "scenes", "median ms", "accuracy", "evaluations", title="Whole matches")
    for row in results.matches:
        figures = f"{row['milliseconds']:.1f}", f"{row['accuracy']:.3f}", f"{row['evaluations']:.3g}"
        table.add_row(row["case"], str(row["scenes"]), *figures)
    console.print(table)
    spent = results.contraction
    console.print(
        f"contraction of {spent['hyperedges']:.3g} hyper-edges: {spent['milliseconds']:.2f} ms, one thread "
        f"{spent['milliseconds_one_thread']:.2f} ms; numpy.add.at {spent['milliseconds_add_at']:.0f} ms, "
        f"{spent['ratio']:.0f} times as long"
    )
    room = results.memory
    peak = "not known here" if room["peak_megabytes"] is None else f"{room['peak_megabytes']:.0f} MiB"
    console.print(
        f"{room['case']}: {room['hyperedges'] / 1e6:.3g} M hyper-edges, {room['kept']} kept at "
        f"{room['bytes_each']:.0f} bytes; peak memory {peak}"
    )

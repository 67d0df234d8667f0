"""The command ``rootmatch warmup``: kernels compiled ahead of the first match."""

from __future__ import annotations

from typing import Annotated

import typer

from rootmatch.cli.surroundings import note_remainder


def warmup(
    everything: Annotated[
        bool, typer.Option("--all", help="Every problem, kind of residual and solver; several minutes.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Compile the kernels of ordinary matches for this machine, on all cores.

    The kernels of a wheel run on any processor of its kind; those compiled here are made for this one and take
    precedence. Run it once for each version of rootmatch, Numba and Python. Without a wheel, the first match would have
    to compile them.

    Exit code 0: compiled; 130: interrupted, what is compiled is kept.
    """
    from rootmatch.cli.progress import progress_bar
    from rootmatch.precompile import warm_up

    note_remainder("what is compiled is kept")
    with progress_bar("kernels", not quiet) as progress:
        warm_up("all" if everything else "first", progress)

"""Progress of long work on standard error, so that standard output stays the answer alone."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

AFTER = 2.0
"""Seconds of work after which a bar shows unasked."""
STEPS = 10
"""Lines in all where there is no terminal to draw a bar in."""

Show = Callable[[int, int], None]


@contextmanager
def shown(what: str, wanted: bool | None) -> Iterator[Show | None]:
    """Give a callback for (done, total), or None where nothing is to be shown.

    Parameters
    ----------
    what : str
        Named before the bar.
    wanted : bool, optional
        Always or never; by default in a terminal only, and only once the work has taken a while.
    """
    in_terminal = sys.stderr.isatty()
    if wanted is False or (wanted is None and not in_terminal):
        yield None
    elif in_terminal:
        with _bar(what, 0.0 if wanted else AFTER) as show:
            yield show
    else:
        yield _lines(what)


@contextmanager
def _bar(what: str, after: float) -> Iterator[Show]:
    """A bar with the time left, drawn from ``after`` seconds on."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = TextColumn(what), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task(what, total=None)
    started = time.monotonic()

    def show(done: int, total: int) -> None:
        if not bar.live.is_started and time.monotonic() - started >= after:
            bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield show
    finally:
        if bar.live.is_started:
            bar.stop()


def _lines(what: str) -> Show:
    """A line at the start and after each tenth of the work, for a file or a pipe."""
    said = -1

    def show(done: int, total: int) -> None:
        nonlocal said
        step = STEPS * done // max(total, 1)
        if step > said:
            said = step
            print(f"{what}: {100 * done // max(total, 1)} %", file=sys.stderr, flush=True)

    return show

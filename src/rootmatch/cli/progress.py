"""Progress bars on standard error, so that standard output holds results only."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rootmatch.backends.strongest import Progress as Show

DELAY = 2.0
"""Seconds of work after which a bar appears by default."""
STEPS, INTERVAL = 10, 30.0
"""Progress lines in total where there is no terminal to draw a bar in, but one at least in so many seconds."""


@contextmanager
def progress_bar(what: str, wanted: bool | None) -> Iterator[Show | None]:
    """Yield a callback for (done, total), or None if no progress is shown.

    ``what``: label of the bar. ``wanted``: show it always or never; by default in a terminal only, once the work has
    taken `DELAY` seconds.
    """
    in_terminal = sys.stderr.isatty()
    if wanted is False or (wanted is None and not in_terminal):
        yield None
    elif in_terminal:
        with _bar(what, 0.0 if wanted else DELAY) as show:
            yield show
    else:
        yield _lines(what)


@contextmanager
def _bar(what: str, delay: float) -> Iterator[Show]:
    """A bar with the remaining time, drawn after a delay in seconds."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = TextColumn(what), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task(what, total=None)
    started = time.monotonic()

    def show(done: int, total: int) -> None:
        if not bar.live.is_started and time.monotonic() - started >= delay:
            bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield show
    finally:
        if bar.live.is_started:
            bar.stop()


def _lines(what: str) -> Show:
    """Lines with the remaining time, for a file or a pipe: at the start, and as the work goes on."""
    reported, started = -1, time.monotonic()
    told = started

    def show(done: int, total: int) -> None:
        nonlocal reported, told
        now, step = time.monotonic(), STEPS * done // max(total, 1)
        if step > reported or now - told > INTERVAL:
            reported, told = step, now
            left = timedelta(seconds=round((now - started) * (total - done) / max(done, 1)))
            after = f", about {left} left" if total <= 100 * done < 100 * total else ""
            print(f"{what}: {100 * done // max(total, 1)} %{after}", file=sys.stderr, flush=True)

    return show

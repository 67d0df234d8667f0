"""Progress of a long run, with the time left, on stderr."""

from __future__ import annotations

import sys
import time
from datetime import timedelta
from types import TracebackType
from typing import Protocol


class Progress(Protocol):
    """Receives the progress of a run."""

    def begin(self, title: str, total: int) -> None:
        """Start a stage of ``total`` steps."""
        ...

    def advance(self, steps: int) -> None:
        """Count ``steps`` more steps as done."""
        ...


class Console:
    """A bar with elapsed and remaining time on a terminal; a line every half minute elsewhere, as in a log file."""

    INTERVAL = 30.0  # seconds

    def __init__(self) -> None:
        from rich import console, progress

        self._console = console.Console(stderr=True)
        columns = [
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TextColumn("elapsed"),
            progress.TimeElapsedColumn(),
            progress.TextColumn("left"),
            # Units come in seconds apart: an estimate over few of them would jump about.
            progress.TimeRemainingColumn(elapsed_when_finished=False),
        ]
        self._bar = progress.Progress(
            *columns, console=self._console, speed_estimate_period=300.0, disable=not self._console.is_terminal
        )
        self._task: progress.TaskID | None = None
        self._title, self._total, self._done = "", 0, 0
        self._started = self._told = time.monotonic()

    def __enter__(self) -> Console:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def begin(self, title: str, total: int) -> None:
        """Start a stage of ``total`` steps."""
        self._title, self._total, self._done = title, total, 0
        self._started = self._told = time.monotonic()
        self._task = self._bar.add_task(title, total=total)
        if not self._console.is_terminal:
            print(f"{title}: {total} rows to compute", file=sys.stderr, flush=True)

    def advance(self, steps: int) -> None:
        """Count ``steps`` more steps as done."""
        self._done += steps
        if self._task is not None:
            self._bar.advance(self._task, steps)
        now = time.monotonic()
        finished = self._done >= self._total
        if not self._console.is_terminal and (finished or now - self._told > self.INTERVAL):
            self._told = now
            left = (now - self._started) * (self._total - self._done) / self._done
            text = f"{self._title}: {self._done} of {self._total} rows, about {timedelta(seconds=round(left))} left"
            if finished:
                text = f"{self._title}: done in {timedelta(seconds=round(now - self._started))}"
            print(text, file=sys.stderr, flush=True)

"""Command lines in this process, and in forked children, which have everything imported already: each takes 10 ms."""

from __future__ import annotations

import contextlib
import csv
import os
import signal
import sys
import time
import traceback
import types
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numba.np.ufunc import parallel
from typer.testing import CliRunner

from rootmatch.cli import app


def run(*arguments: object, text: str | None = None) -> Any:
    """Run a command in this process."""
    return CliRunner().invoke(app, [str(one) for one in arguments], input=text, catch_exceptions=False)


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a table, by its header."""
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@dataclass
class Command:
    """A command that runs in a session of its own; what it prints goes to files of ``logs``."""

    pid: int
    logs: Path
    code: int | None = None

    def ended(self, seconds: float) -> bool:
        """Wait for its end; whether it came in time. Signals are negative codes."""
        ends = time.monotonic() + seconds
        while self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > ends:
                return False
            else:
                time.sleep(0.002)
        return True

    def worked(self) -> float:
        """Seconds of the processor that it and its children have used; 0 where there is no /proc."""
        ticks = 0
        for pid in (self.pid, *descendants(self.pid)):
            with contextlib.suppress(OSError):
                words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
                ticks += int(words[11]) + int(words[12])
        return ticks / os.sysconf("SC_CLK_TCK")

    def alone(self, seconds: float) -> bool:
        """Whether nothing of its session is left, at the latest after some seconds; what is left is killed."""
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            try:
                os.killpg(self.pid, 0)
            except ProcessLookupError:
                return True
            time.sleep(0.01)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        return False

    def kill(self) -> None:
        """Kill it alone, as the system does that is short of memory, and bury it."""
        os.kill(self.pid, signal.SIGKILL)
        self.ended(60.0)

    @property
    def stdout(self) -> str:
        return (self.logs / "stdout").read_text(encoding="utf-8", errors="replace")

    @property
    def stderr(self) -> str:
        return (self.logs / "stderr").read_text(encoding="utf-8", errors="replace")


def descendants(pid: int) -> list[int]:
    """Children of a process, and theirs."""
    found: list[int] = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += map(int, path.read_text().split())
    return found + [one for child in found for one in descendants(child)]


def started(
    words: list[str],
    folder: Path,
    logs: Path,
    stdin: Path | str = os.devnull,
    closed: tuple[int, ...] = (),
    fresh: bool = False,
    stdout: int | None = None,
) -> Command:
    """Start a command in a folder, with standard streams (0 to 2) closed where they are named.

    A fresh one imports everything itself, as anybody's does. Its output goes to a file of ``logs`` or a descriptor.
    """

    def work() -> int:
        _surrounded(folder, logs, stdin, closed)
        if stdout is not None:
            os.dup2(stdout, 1)
        if fresh:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            os.execv(sys.executable, [sys.executable, "-c", "from rootmatch.cli import main; main()", *words])
        return _run(words, logs, closed)

    return forked(work, logs)


def forked(work: Callable[[], int], logs: Path) -> Command:
    """A child in a session of its own that does some work, whose code it ends with."""
    logs.mkdir(parents=True, exist_ok=True)
    for name in ("stdout", "stderr"):
        (logs / name).write_bytes(b"")  # which can be read before the child has begun
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: none of ours holds a lock
        child = os.fork()
    if child:
        return Command(child, logs)
    code = 70
    try:
        os.setsid()
        parallel._set_init_process_lock()  # the other one may be held by a child that was killed
        sys.modules["__main__"] = types.ModuleType("__main__")  # workers need not import that of the tests
        code = work()
    finally:
        os._exit(code)


def _surrounded(folder: Path, logs: Path, stdin: Path | str, closed: tuple[int, ...]) -> None:
    """Give this process a folder and standard streams of its own."""
    os.chdir(folder)
    places = (stdin, os.O_RDONLY), (logs / "stdout", os.O_WRONLY), (logs / "stderr", os.O_WRONLY)
    for number, (place, mode) in enumerate(places):
        made = 0 if number == 0 else os.O_CREAT | os.O_TRUNC
        os.dup2(os.open(place, mode | made, 0o600), number)
    for number in closed:
        os.close(number)


def _run(words: list[str], logs: Path, closed: tuple[int, ...]) -> int:
    names = ("stdin", "stdout", "stderr")
    for number, name in enumerate(names):
        stream = None if number in closed else open(number, "r" if number == 0 else "w", encoding="utf-8")  # noqa: SIM115
        setattr(sys, name, stream)
    sys.argv = ["rootmatch", *words]
    from rootmatch.cli import main

    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        main()
    except SystemExit as end:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it has ended; what comes now is late
        code = end.code if isinstance(end.code, int) else 0
    except BaseException:
        with open(logs / "stderr", "a", encoding="utf-8") as file:
            traceback.print_exc(file=file)
        return 71
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.flush()
    return code or 0

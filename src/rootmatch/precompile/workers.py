"""The steps shared out among processes, which the compiler, holding one lock, needs to use several cores."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock
from typing import Any

from rootmatch.backends.strongest import Progress
from rootmatch.errors import RootmatchError
from rootmatch.jit import prebuilt
from rootmatch.precompile.steps import STEPS

MOST_WORKERS = 8
"""A worker takes 300 MB and works for a minute."""


def warm_up(chosen: str = "first", progress: Progress | None = None, workers: int | None = None) -> None:
    """Compile kernels for this machine into the user's cache.

    Parameters
    ----------
    chosen : str
        A name of `rootmatch.precompile.steps.STEPS`.
    progress : callable, optional
        Called with (done, total) after each step.
    workers : int, optional
        Processes; by default one for each core.

    Raises
    ------
    RootmatchError
        If a step fails; its last words are in the text.
    """
    _run(chosen, [], {}, progress, workers)


def prebuild(folder: Path, progress: Progress | None = None) -> None:
    """Compile kernels for a generic processor into a folder, for a wheel of this Python and Numba.

    Raises
    ------
    RootmatchError
        On a processor that `rootmatch.jit.prebuilt.GENERIC` does not name, or if a step fails.
    """
    if prebuilt.architecture() not in prebuilt.GENERIC:
        raise RootmatchError(f"no generic processor is known for {prebuilt.architecture()}; install without kernels")
    processor, _ = prebuilt.GENERIC[prebuilt.architecture()]
    folder.mkdir(parents=True, exist_ok=True)
    generic = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": ""}
    _run("prebuilt", [str(folder)], generic, progress)
    prebuilt.write_manifest(folder)


def _run(
    chosen: str,
    arguments: list[str],
    environment: dict[str, str],
    progress: Progress | None,
    workers: int | None = None,
) -> None:
    """Run all steps of a set, each in whichever worker is free."""
    names = list(STEPS[chosen]())
    waiting: SimpleQueue[str] = SimpleQueue()
    for name in names:
        waiting.put(name)
    done, lock = [0], Lock()
    if progress is not None:
        progress(0, len(names))

    def finished() -> None:
        with lock:
            done[0] += 1
            if progress is not None:
                progress(done[0], len(names))

    command = [sys.executable, "-m", "rootmatch.precompile.worker", chosen, *arguments]
    processes = [_started(command, environment) for _ in range(workers or min(os.cpu_count() or 1, MOST_WORKERS))]
    try:
        with ThreadPoolExecutor(len(processes)) as pool:
            try:
                failures = list(pool.map(lambda process: _served(process, waiting, finished), processes))
            finally:  # Ctrl-C: the pool waits for its threads, and these for the workers
                for process in processes:
                    process.kill()
        for failure in failures:
            if failure:
                raise RootmatchError(failure)
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _started(command: list[str], environment: dict[str, str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command,
        env={**os.environ, "NUMBA_NUM_THREADS": "1", **environment},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _served(process: subprocess.Popen[Any], waiting: SimpleQueue[str], finished: Callable[[], None]) -> str | None:
    """Give a worker one step after the other; what went wrong, or None."""
    while True:
        try:
            name = waiting.get_nowait()
        except Empty:
            return None
        try:
            process.stdin.write(f"{name}\n")  # type: ignore[union-attr]
            process.stdin.flush()  # type: ignore[union-attr]
            answer = process.stdout.readline()  # type: ignore[union-attr]
        except BrokenPipeError:
            answer = ""
        if answer != "done\n":
            _, words = process.communicate()
            return f"warm-up, {name}: {' '.join(words.split()[-60:])}"
        finished()

"""Workers that end with their parent, however it ends: SIGKILL leaves it no time to tell them."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

INTERVAL = 1.0
"""Seconds between two looks at the parent."""


@contextmanager
def pool(processes: int, environment: dict[str, str] | None = None) -> Iterator[Any]:
    """An executor whose workers compute on one thread each and end with this process, or with the block.

    They know of their parent before they are given anything, and leave Ctrl-C to it. Variables of the ``environment``
    are set in theirs.

    Raises `concurrent.futures.process.BrokenProcessPool` from a future's ``result()``, if a worker was killed.
    """
    from joblib.externals.loky import ProcessPoolExecutor

    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    all_set = one | (environment or {})
    executor = ProcessPoolExecutor(processes, initializer=_begin, initargs=(os.getpid(),), env=all_set)
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, kill_workers=True)


def _begin(parent: int) -> None:
    threading.Thread(target=_watch, args=(parent,), name="end-with-parent", daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _watch(parent: int) -> None:
    # an orphan gets another parent; exit() would wait for work that nobody is to have
    while os.getppid() == parent:
        time.sleep(INTERVAL)
    os._exit(1)

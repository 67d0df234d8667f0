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

_watched: set[int] = set()


def end_with(parent: int) -> None:
    """End this process soon after its parent has ended; watching begins with the first call.

    Parameters
    ----------
    parent : int
        Process id of the parent as it knows itself. A process that is not its child, such as the parent itself where
        there are no workers, is left alone; one whose parent is no more ends at once.
    """
    if parent in _watched or os.getpid() == parent:
        return
    if os.getppid() != parent:
        if not _is_there(parent):
            os._exit(1)
        return
    _watched.add(parent)
    threading.Thread(target=_watch, args=(parent,), name="end-with-parent", daemon=True).start()


def _is_there(process: int) -> bool:
    if os.name == "nt":  # a signal would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _watch(parent: int) -> None:
    # an orphan gets another parent; exit() would wait for work that nobody is to have
    while os.getppid() == parent:
        time.sleep(INTERVAL)
    os._exit(1)


@contextmanager
def pool(processes: int, environment: dict[str, str] | None = None) -> Iterator[Any]:
    """An executor whose workers compute on one thread each and end with this process, or with the block.

    They know of their parent before they are given anything, and leave Ctrl-C to it. Variables of the ``environment``
    are set in theirs.

    Raises
    ------
    concurrent.futures.process.BrokenProcessPool
        From a future's ``result()``, if a worker was killed.
    """
    from joblib.externals.loky import ProcessPoolExecutor

    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    executor = ProcessPoolExecutor(
        processes, initializer=_begin, initargs=(os.getpid(),), env=one | (environment or {})
    )
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, kill_workers=True)


def _begin(parent: int) -> None:
    end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)

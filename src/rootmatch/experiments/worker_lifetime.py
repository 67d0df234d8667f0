"""Workers that end with their parent, however it ends: SIGKILL leaves it no time to tell them."""

from __future__ import annotations

import os
import threading
import time

INTERVAL = 1.0
"""Seconds between two looks at the parent."""

_watched: set[int] = set()


def end_with(parent: int) -> None:
    """End this process soon after its parent has ended; watching begins with the first call.

    Parameters
    ----------
    parent : int
        Process id of the parent as it knows itself. A process that is not its child, such as the parent itself where
        there are no workers, is left alone.
    """
    if parent in _watched or os.getppid() != parent:
        return
    _watched.add(parent)
    threading.Thread(target=_watch, args=(parent,), name="end-with-parent", daemon=True).start()


def _watch(parent: int) -> None:
    # an orphan gets another parent; exit() would wait for work that nobody is to have
    while os.getppid() == parent:
        time.sleep(INTERVAL)
    os._exit(1)

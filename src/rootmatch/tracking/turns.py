"""Threads that use one object take turns."""

from __future__ import annotations

import threading
from types import TracebackType


class Turns:
    """A lock that the thread which has it may take again; an object with one can be copied and pickled."""

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[Turns], tuple[()]]:
        """Of a copy: nobody has it."""
        return Turns, ()

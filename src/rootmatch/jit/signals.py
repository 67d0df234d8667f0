"""Signals wait while LLVM loads code: an exception in a function that it calls is lost, and with it the code."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Any

RAISING = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGALRM", "SIGPROF", "SIGVTALRM", "SIGUSR1", "SIGUSR2")
    if hasattr(signal, name)
)
"""Signals whose handlers may raise: those that end a program, and those of timers and of users."""


class _Waiting:
    """Takes the place of a signal's handler."""

    def __init__(self, number: int, handler: Callable[[int, FrameType | None], Any]) -> None:
        self.number, self.handler = number, handler
        self.waits = True
        self.came: list[FrameType | None] = []

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.waits:
            self.came = [frame]
        else:  # an interrupt has kept the handler from being put back
            self.handler(number, frame)


@contextmanager
def defer_signals() -> Iterator[None]:
    """Call the handlers of signals that come during the block at its end, once each.

    Handlers run in the main thread alone, so nothing is to be done in others.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    every: list[_Waiting] = []
    try:
        for number in RAISING:
            handler = signal.getsignal(number)
            if callable(handler) and not isinstance(handler, signal.Handlers):
                every.append(_Waiting(number, handler))
                signal.signal(number, every[-1])
        yield
    finally:
        for one in every:
            one.waits = False
        for one in every:
            signal.signal(one.number, one.handler)
        with ExitStack() as stack:  # all of them, though one raises
            for one in every:
                for frame in one.came:
                    stack.callback(one.handler, one.number, frame)

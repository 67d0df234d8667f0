"""The environment of a command: signals, and a standard output that may be closed, full or not Unicode."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

Command = Callable[..., None]

NOTHING_LEFT = "no partial output is left"

_received: list[int] = []
_left = [NOTHING_LEFT]


def prepare_streams() -> None:
    """Take SIGTERM for an interruption, so that what is half-written is removed, and print what an encoding lacks."""
    if hasattr(signal, "SIGTERM"):
        signal.signal(signal.SIGTERM, _interrupt)
    for name in ("stdout", "stderr"):
        stream: Any = getattr(sys, name)
        if stream is None:  # closed, as by >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _interrupt(number: int, frame: Any) -> None:
    _received.append(number)
    signal.signal(number, signal.SIG_IGN)  # another one would strike while the first is seen to
    raise KeyboardInterrupt


def note_remainder(text: str) -> None:
    """Note what a signal leaves of the command that has begun, for the line that says so; until then it is nothing."""
    _left[0] = text


def copy_pipes(*names: str) -> Callable[[Command], Command]:
    """Let a command read its arguments of these names, paths, more than once, though they may be pipes."""

    def copied(command: Command) -> Command:
        @wraps(command)
        def called(*args: Any, **options: Any) -> None:
            from rootmatch.io.inputs import make_rereadable

            with ExitStack() as copies:
                again = {name: copies.enter_context(make_rereadable(options[name])) for name in names}
                command(*args, **options | again)

        return called

    return copied


def render_text(draw: Callable[[Console], None]) -> str:
    """What is drawn on a console of rich, which by itself ends a program whose reader has gone with 1."""
    from rich.console import Console

    console = Console()
    with console.capture() as captured:
        draw(console)
    return captured.get()


def describe_stop() -> tuple[bool, str]:
    """Whether SIGTERM has come, and what a signal leaves."""
    return bool(_received), _left[0]


def discard_output() -> None:
    """Send standard output nowhere, so that what it still holds is not tried again at the end."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # not a file, as under a test
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115

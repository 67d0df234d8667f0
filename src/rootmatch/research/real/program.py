"""A method that runs as a program of its own: asked by a line, answered by a line, ended when it is late."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import threading
import time
from queue import Empty, Queue
from typing import Any

from rootmatch.errors import InputError, RootmatchError, quote_value
from rootmatch.research.real.methods import METHODS

LONGEST_LINE = 10_000_000
"""Bytes of a reply."""


class Program:
    """A running method.

    Parameters
    ----------
    method : str
        A name of this library's own methods, or a command line.
    start_up : float
        Seconds that it may take for its first reply, compiling included.
    """

    def __init__(self, method: str, start_up: float = 120.0) -> None:
        self.command = (
            [sys.executable, "-m", "rootmatch.research.real.methods", method] if method in METHODS else _words(method)
        )
        self.start_up = start_up
        self._process: subprocess.Popen[bytes] | None = None
        self._lines: Queue[bytes | None] = Queue()
        self._answered = False

    def ask(self, request: dict[str, Any], timeout: float) -> dict[str, Any]:
        """The reply, with ``wall`` seconds; with ``error`` where there is none in time or it is none."""
        process = self._ensure_running()
        started = time.perf_counter()
        try:
            assert process.stdin is not None
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
            line = self._lines.get(timeout=timeout if self._answered else self.start_up)
        except (BrokenPipeError, OSError):
            line = None
        except Empty:
            self.close()
            return {"error": f"no reply within {timeout:g} s", "wall": timeout}
        wall = time.perf_counter() - started
        if line is None:
            self.close()
            return {"error": "the program ended", "wall": wall}
        self._answered = True
        try:
            found = json.loads(line)
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict) or ("assignment" not in found and "error" not in found):
            return {
                "error": f"no reply in JSON: {quote_value(line.strip()[:80].decode(errors='replace'))}",
                "wall": wall,
            }
        return {**found, "wall": wall}

    def close(self) -> None:
        """End the program, whatever it is at; the next request starts another."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _ensure_running(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is None:
            return self._process
        try:
            process = subprocess.Popen(self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"method: {quote_value(shlex.join(self.command))} cannot be started ({reason})") from None
        self._process, self._lines, self._answered = process, Queue(), False
        if process.stdout is None:
            raise RootmatchError("method: its output cannot be read")
        threading.Thread(target=_forward, args=(process.stdout, self._lines), daemon=True).start()
        return process


def _words(method: str) -> list[str]:
    """The command and its arguments."""
    try:
        words = shlex.split(method)
    except ValueError as error:
        raise InputError(f"method: {quote_value(method)} is no command line ({error}); check its quotes") from None
    if not words:
        raise InputError(f"method: {quote_value(method)} given; give {', '.join(METHODS)}, or the command of a program")
    return words


def _forward(lines: Any, queue: Queue[bytes | None]) -> None:
    """Put lines into a queue, and None at their end; a line without end counts as several."""
    while line := lines.readline(LONGEST_LINE):
        queue.put(line)
    queue.put(None)

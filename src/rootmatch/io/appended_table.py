"""A CSV file that grows frame by frame: each frame is there once written, and a run that stopped is continued.

The first column is the frame's number, and numbers ascend. Beside a file that can be continued stands another one,
``NAME.settings.json``, with the settings that it was begun with: frames of other settings are not mixed into it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from io import FileIO
from pathlib import Path
from typing import Any

from rootmatch.errors import InputError, quote_value
from rootmatch.io.csv_tables import csv_text
from rootmatch.io.outputs import Writable, is_written_through, open_sink, write_all

try:
    import fcntl
except ImportError:  # Windows: nothing keeps two processes from one file
    fcntl = None  # type: ignore[assignment]

SETTINGS_SUFFIX = ".settings.json"
MAX_DIGITS = 18
"""Digits of a frame's number: it then is a 64-bit integer, as other programs read it."""


class AppendedTable:
    """A CSV file that is written as results come, each frame's rows at once; nothing of it is ever written anew.

    Parameters
    ----------
    path : path
        A file, through links to it; a device or pipe is written through. Until it has a row there is no file.
    header : sequence of str
    settings : mapping of str to str, optional
        What rows depend on, kept beside the file.
    delimiter : str
        Between the cells.
    resume : bool
        Whether to continue a file that is there; refuse it otherwise. Its last frame, which may not be whole, is
        written again.

    Attributes
    ----------
    done : set of int
        Frames that the file held already.

    Raises
    ------
    InputError
        If the file is there and not to be continued, was begun with other settings or holds other rows, or another
        process is writing to it.
    """

    def __init__(
        self,
        path: Path,
        header: Sequence[str],
        settings: Mapping[str, str] | None = None,
        resume: bool = False,
        *,
        delimiter: str = ",",
    ) -> None:
        self.path, self.settings, self.done = path, settings, set[int]()
        self._delimiter = delimiter
        self._place: Path | None = None
        self._header = delimiter.join(header).encode() + b"\n"
        self._begun = self._made = False
        self._open = ExitStack()
        with ExitStack() as on_error:
            on_error.callback(self.close)
            if is_written_through(path):
                if resume:
                    raise InputError(f"{path}: this file cannot be continued; leave --resume out")
                self._stream: Writable = self._open.enter_context(open_sink(path))
            else:
                self._place = Path(os.path.realpath(path))
                self._stream = self._open.enter_context(self._open_locked(self._place))
                self._resume_or_clear(self._stream, self._place, resume)
            on_error.pop_all()

    def write(self, rows: Iterable[Sequence[Any]]) -> None:
        """Append the rows of one frame; they are in the file when this returns."""
        content = csv_text(rows, self._delimiter).encode()
        try:
            if not self._begun:
                self._write_settings()
                content = self._header + content
                self._begun = True
            write_all(self._stream, content)
            self._stream.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            raise InputError(
                f"{self.path}: cannot be written ({error.strerror}); free some space: earlier frames are kept"
            ) from None

    def close(self) -> None:
        """Close the file; one without a row that was not there before is removed."""
        if self._place is not None and self._made and not self._begun:
            with suppress(OSError):
                self._place.unlink()
        self._open.close()

    def _open_locked(self, place: Path) -> FileIO:
        """The file opened, and locked for as long as this process lives."""
        try:
            while True:
                try:
                    handle = os.open(place, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
                    self._made = True
                except FileExistsError:
                    handle = os.open(place, os.O_RDWR)
                    self._made = False
                stream = FileIO(handle, "r+")
                if not _try_lock(handle):
                    stream.close()
                    self._made = False
                    raise InputError(f"{self.path}: another process is writing to it; wait, or give another file")
                with suppress(FileNotFoundError):  # removed by the one that had it
                    if os.path.samestat(os.fstat(handle), os.stat(place)):
                        return stream
                stream.close()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror}); choose another location") from None

    def _resume_or_clear(self, stream: FileIO, place: Path, resume: bool) -> None:
        """See what is there, and cut off what is not whole."""
        if self._header.startswith(stream.read(len(self._header) + 1)):
            stream.seek(0)  # nothing, or a header without rows
            stream.truncate()
            return
        if not resume:
            other = "give another name" if self.settings is None else "add --resume to continue it"
            raise InputError(f"{self.path}: it already exists, with rows of an earlier run; remove it, or {other}")
        self._check_settings(_settings_file(place))
        stream.seek(0)
        end = self._find_last_frame(stream)
        stream.seek(end)
        stream.truncate()
        self._begun = True

    def _find_last_frame(self, stream: FileIO) -> int:
        """Position at which the last frame begins; earlier frames are complete."""
        begin = position = 0
        last = -1
        with open(os.dup(stream.fileno()), "rb") as lines:
            for row, line in enumerate(lines, start=1):
                if row == 1:
                    if line != self._header:
                        expected = self._header.decode()[:40]
                        raise InputError(f"{self.path}: its header is not {expected}…; give another file")
                    begin = len(line)
                elif line.endswith(b"\n"):
                    frame = self._parse_frame(row, line)
                    if frame < last:
                        raise InputError(
                            f"{self.path}, row {row}: frame {frame} after frame {last}; give the file as it was written"
                        )
                    if frame > last:
                        self.done.add(last)
                        begin, last = position, frame
                position += len(line)
        self.done.discard(-1)
        return begin

    def _parse_frame(self, row: int, line: bytes) -> int:
        text = line.rstrip(b"\n").decode(errors="replace")
        cell, comma, _ = text.partition(",")
        if not comma or not cell.isascii() or not cell.isdigit() or len(cell) > MAX_DIGITS or "\ufffd" in text:
            raise InputError(f"{self.path}, row {row}: {quote_value(text)} is not a row of a frame; remove it")
        return int(cell)

    def _write_settings(self) -> None:
        """Before the first row; what a kill leaves of it is not read, as there is no row yet."""
        if self.settings is not None and self._place is not None:
            text = json.dumps(dict(self.settings), indent=1) + "\n"
            _settings_file(self._place).write_text(text, encoding="utf-8")

    def _check_settings(self, file: Path) -> None:
        """Refuse to continue with other settings than those of the rows that are there."""
        if self.settings is None:
            return
        try:
            known = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            known = None
        if not isinstance(known, dict):
            raise InputError(
                f"{self.path}: its settings, {file.name}, are missing or cannot be read; give another file"
            )
        for name in {**self.settings, **known}:
            old, new = known.get(name), self.settings.get(name)
            if old != new:
                told = f"{quote_value(new)} given, but the file was begun with {quote_value(old)}"
                raise InputError(f"{self.path}: {name}: {told}; give the same again, or another file")


def _settings_file(place: Path) -> Path:
    return place.with_name(place.name + SETTINGS_SUFFIX)


def _try_lock(handle: int) -> bool:
    """Take the lock on an open file; False where another process has it."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True

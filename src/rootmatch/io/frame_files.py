"""CSV files of many images: detections with a column ``frame`` or ``time``, read as they come."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.errors import InputError, quote_value
from rootmatch.io.appended_table import MAX_DIGITS
from rootmatch.io.csv_tables import iterate_rows, parse_header, parse_number
from rootmatch.io.inputs import name_unreadable
from rootmatch.io.known_files import COLUMNS, KnownInImage, has_known_columns
from rootmatch.io.noise_columns import COVARIANCE, find_noise_columns, noise_array, parse_row_noise

STANDARD_INPUT = Path("-")
MAX_DETECTIONS = 100_000
"""Maximum number of detections in a frame; a match takes a tenth of them."""
LONGEST_LINE = 1_000_000
EXACT = 2.0**53
"""Up to here floating-point numbers tell each whole number from the next."""


@dataclass(frozen=True)
class Frame:
    """The detections of one image."""

    number: int
    points: Floats
    """(m, 2) pixels; of a rig (m, 3), the camera's index the third."""
    time: float | None = None
    """Seconds, where the file has a column ``time``."""
    sigma: Floats | None = None
    """(m,) σ of each detection, where the file has a column ``sigma``, or (m, 2, 2) covariances, where it has
    ``sxx,sxy,syy``."""
    known: Any = None
    """What is known of the pose, where the file has such columns (`rootmatch.io.known_files`): a `rootmatch.PosePrior`;
    by label where another file tells it of bodies."""
    fault: str | None = None
    """Why it is out of order, or its detections could not all be read, where that is allowed."""


def has_frames(path: Path) -> bool:
    """Whether the header of a file names a column ``frame`` or ``time``; standard input is assumed to."""
    if path == STANDARD_INPUT:
        return True
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            header = next((line for line in _iterate_lines(path, stream) if line.strip()), "")
    except (OSError, ValueError):
        return False  # who reads it as one image says what is wrong
    return not {"frame", "time"}.isdisjoint(parse_header(header.split(",")))


def read_frames(path: Path, dimension: int = 2, *, of_rig: bool = False, skipping: bool = False) -> Iterator[Frame]:
    """Frames of a CSV file with columns ``frame,x,y`` or ``time,x,y``, each as soon as it ends.

    A frame ends where the next one begins, at an empty line, or with the file. A row without coordinates, such as
    ``7,,``, is of a frame without detections.

    Parameters
    ----------
    path : path
        The file, ``-`` for standard input. Rows of one frame follow one another, and numbers, or times, ascend.
        ``frame`` counts, ``time`` is in seconds, in any steps; frames that have a time alone are numbered from 0. A
        column ``sigma`` is the σ of each detection, ``sxx,sxy,syy`` its covariance; columns of
        `rootmatch.io.known_files.COLUMNS` say what is known of the pose of a frame, in one of its rows or in all.
    dimension : int
        2 for pixels, 3 for unit rays ``x,y,z``.
    of_rig : bool
        Whether they are detections of several cameras: ``frame,x,y,camera``, with the camera's index from 0.
    skipping : bool
        Whether a detection that cannot be read spoils its frame alone, and a frame out of order itself; see
        `Frame.fault`.
    """
    name = Path("standard input") if path == STANDARD_INPUT else path
    with _open_input(path) as stream:
        axes = ("x", "y", "camera") if of_rig else ("x", "y", "z")[:dimension]
        yield from _iterate_frames(name, stream, axes, skipping)


class _Frames:
    """The frame that is being read, and what those before it leave to check."""

    def __init__(self, path: Path, header: list[str], axes: tuple[str, ...], skipping: bool) -> None:
        self.path, self.axes, self.skipping = path, axes, skipping
        self.fault: str | None = None
        self.numbered, self.timed = (name in header for name in ("frame", "time"))
        self.noisy = find_noise_columns(path, header)
        self.key: tuple[int, float | None] | None = None
        self._latest: tuple[int, float | None] | None = None
        self.ended = True
        self._points: list[list[float]] = []
        self._sigma: list[list[float]] = []
        self._known = KnownInImage(path) if has_known_columns(path, header) else None

    def take(self, row: int, cells: dict[str, str]) -> Iterator[Frame]:
        """Add a row; yield the frame that ends before it."""
        where = f"{self.path}, row {row}"
        time = parse_number(self.path, row, "time", cells["time"]) if self.timed else None
        if self.numbered:
            key = _parse_frame_number(self.path, row, cells["frame"]), time
        else:  # the time alone tells frames apart
            key = 0 if self.key is None else self.key[0] + (time != self.key[1]), time
        if key != self.key:
            yield from self.end()
            try:
                self._check_order(where, *key)
            except InputError as error:
                if not self.skipping:
                    raise
                self.fault = str(error)
            else:
                self._latest = key
            self.key, self.ended = key, False
        elif self.ended:
            raise InputError(
                f"{where}: {self._name(*key)} continues after an empty line, which ends a frame; remove it"
            )
        if self._known is not None:
            self._known.take(row, cells)
        if self.fault is None and any(cells[axis] for axis in self.axes):
            try:
                self._add_detection(row, cells)
            except InputError as error:
                if not self.skipping:
                    raise
                self.fault = str(error)

    def _add_detection(self, row: int, cells: dict[str, str]) -> None:
        assert self.key is not None
        where, key = f"{self.path}, row {row}", self.key
        if len(self._points) == MAX_DETECTIONS:
            raise InputError(f"{where}: more than {MAX_DETECTIONS:,} detections in {self._name(*key)}")
        point = [parse_number(self.path, row, axis, cells[axis]) for axis in self.axes]
        self._sigma.append(parse_row_noise(self.path, row, self.noisy, cells))
        self._points.append(point)

    def end(self) -> Iterator[Frame]:
        """Yield the frame that was read, if one was begun."""
        if self.key is None or self.ended:
            return
        self.ended = True
        points = np.array(self._points).reshape(-1, len(self.axes))
        sigma = noise_array(self.noisy, self._sigma)
        self._points, self._sigma, fault, self.fault = [], [], self.fault, None
        known = None if self._known is None else self._known.end()
        yield Frame(self.key[0], points, self.key[1], sigma=sigma, known=known, fault=fault)

    def _check_order(self, where: str, frame: int, time: float | None) -> None:
        if self._latest is None:
            return
        before, earlier = self._latest
        if frame == before and time != earlier:
            raise InputError(f"{where}: frame {frame} has two times, {earlier:g} and {time:g}; give one for each frame")
        behind, order = frame <= before, f"frame {frame} after frame {before}"
        if not behind and time is not None and earlier is not None:
            behind, order = time <= earlier, f"time {time:g} after time {earlier:g}"
        if behind:
            raise InputError(f"{where}: {order}; frames are out of order, sort them")

    def _name(self, frame: int, time: float | None) -> str:
        return f"frame {frame}" if self.numbered else f"time {time:g}"


def _iterate_frames(path: Path, stream: TextIO, axes: tuple[str, ...], skipping: bool) -> Iterator[Frame]:
    def needed(header: list[str]) -> tuple[str, ...]:
        return ("time" if "time" in header and "frame" not in header else "frame", *axes)

    known = ("frame", "time", *axes, "sigma", *COVARIANCE, *COLUMNS)
    frames: _Frames | None = None
    try:
        for row, cells in iterate_rows(path, _iterate_lines(path, stream), needed, known):
            if frames is None:
                frames = _Frames(path, list(cells), axes, skipping) if cells else None
            else:
                yield from frames.take(row, cells) if cells else frames.end()
    except UnicodeDecodeError:
        raise InputError(f"{path}: it is not UTF-8 text; save it as UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check that it is a file") from None
    if frames is None or frames.key is None:
        wanted = ",".join(("frame", *axes))
        raise InputError(f"{path}: no row follows the header; give a header {wanted} and one row per detection")
    yield from frames.end()


def _iterate_lines(path: Path, stream: TextIO) -> Iterator[str]:
    """The lines, with a bound on their length."""
    while line := stream.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise InputError(f"{path}: a line of more than {LONGEST_LINE:,} characters; give a CSV file")
        yield line


def _parse_frame_number(path: Path, row: int, text: str) -> int:
    if text.isascii() and text.isdigit() and len(text) <= MAX_DIGITS:
        return int(text)
    with suppress(ValueError):  # `numpy.savetxt` writes 7 as 7.000000000000000000e+00
        value = float(text)
        if value.is_integer() and 0.0 <= value <= EXACT and "_" not in text:
            return int(value)
    raise InputError(f"{path}, row {row}: frame is {quote_value(text)}; give a whole number, 0 or more")


@contextmanager
def _open_input(path: Path) -> Iterator[TextIO]:
    """A file, or standard input, as UTF-8 with or without a byte-order mark, whatever the locale."""
    if path != STANDARD_INPUT:
        with name_unreadable(path):
            stream = path.open(encoding="utf-8-sig", newline="")
        with stream:
            yield stream
        return
    if sys.stdin is None or sys.stdin.closed:
        raise InputError("standard input: it is closed; give a file, or pipe the frames in")
    if not hasattr(sys.stdin, "buffer"):
        yield sys.stdin
        return
    stream = io.TextIOWrapper(sys.stdin.buffer, encoding="utf-8-sig", newline="")
    try:
        yield stream
    finally:
        stream.detach()

"""CSV files of many images: detections with a column ``frame``, read as they come."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from rootmatch.errors import InputError, quoted
from rootmatch.io.appended_table import MOST_DIGITS
from rootmatch.io.csv_tables import check_header, number

STANDARD_INPUT = Path("-")
MOST_DETECTIONS = 100_000
"""Of a frame: a match takes a tenth of them."""
LONGEST_LINE = 1_000_000


@dataclass(frozen=True)
class Frame:
    """The detections of one image.

    Parameters
    ----------
    number : int
    points : (m, 2) array
        Pixels; of a rig (m, 3), the camera's index the third.
    rows : (m,) int64 array
        Rows of the file, the header being row 1.
    """

    number: int
    points: NDArray[np.float64]
    rows: NDArray[np.int64]


def has_frames(path: Path) -> bool:
    """Whether the header of a file names a column ``frame``; standard input is taken to."""
    if path == STANDARD_INPUT:
        return True
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            header = next((line for line in _lines(path, stream) if line.strip()), "")
    except (OSError, ValueError):
        return False  # who reads it as one image says what is wrong
    return "frame" in [cell.strip().lower() for cell in header.split(",")]


def read_frames(path: Path, dimension: int = 2, *, of_rig: bool = False) -> Iterator[Frame]:
    """Frames of a CSV file with columns ``frame,x,y``, each as soon as the next begins.

    Parameters
    ----------
    path : path
        The file, ``-`` for standard input. Rows of one frame follow one another, and numbers ascend.
    dimension : int
        2 for pixels, 3 for unit rays ``x,y,z``.
    of_rig : bool
        Whether they are detections of several cameras: ``frame,x,y,camera``, with the camera's index from 0.

    Raises
    ------
    InputError
        If the file cannot be used; the text names the file, the row and the remedy.
    """
    name = Path("standard input") if path == STANDARD_INPUT else path
    with _opened(path) as stream:
        columns = ("frame", "x", "y", "camera") if of_rig else ("frame", "x", "y", "z")[: dimension + 1]
        yield from _frames(name, stream, columns)


def _frames(path: Path, stream: TextIO, needed: tuple[str, ...]) -> Iterator[Frame]:
    reader = csv.reader(_lines(path, stream), strict=True)
    header: list[str] = []
    number_now, points, rows = -1, list[list[float]](), list[int]()
    try:
        for raw in reader:
            cells = [cell.strip() for cell in raw]
            if not any(cells):
                continue
            row = reader.line_num
            if not header:
                header = [cell.lower() for cell in cells]
                check_header(path, row, header, needed, needed)
                continue
            if len(cells) != len(header):
                raise InputError(f"{path}, row {row}: {len(cells)} values given, {len(header)} expected")
            named = dict(zip(header, cells, strict=True))
            frame = _frame_number(path, row, named["frame"])
            if rows and frame != number_now:
                if frame < number_now:
                    raise InputError(
                        f"{path}, row {row}: frame {frame} after frame {number_now}; frames are out of order, sort them"
                    )
                yield Frame(number_now, np.array(points), np.array(rows, np.int64))
                points, rows = [], []
            if len(rows) == MOST_DETECTIONS:
                raise InputError(f"{path}, row {row}: more than {MOST_DETECTIONS:,} detections in frame {frame}")
            number_now = frame
            points.append([number(path, row, axis, named[axis]) for axis in needed[1:]])
            rows.append(row)
    except csv.Error as error:
        raise InputError(f"{path}, row {reader.line_num}: not comma-separated values ({error})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: it is not UTF-8 text; save it as UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check that it is a file") from None
    if not rows:
        raise InputError(f"{path}: no row follows the header; give a header {','.join(needed)} and a row a detection")
    yield Frame(number_now, np.array(points), np.array(rows, np.int64))


def _lines(path: Path, stream: TextIO) -> Iterator[str]:
    """The lines, none of them without end."""
    while line := stream.readline(LONGEST_LINE):
        if len(line) == LONGEST_LINE:
            raise InputError(f"{path}: a line of more than {LONGEST_LINE:,} characters; give a CSV file")
        yield line


def _frame_number(path: Path, row: int, text: str) -> int:
    if not text.isascii() or not text.isdigit() or len(text) > MOST_DIGITS:
        raise InputError(f"{path}, row {row}: frame is {quoted(text)}; give a whole number, 0 or more")
    return int(text)


def _standard_input() -> Iterator[TextIO]:
    """Standard input as UTF-8 with or without a byte-order mark, whatever the locale."""
    if sys.stdin is None or sys.stdin.closed:
        raise InputError("standard input: it is closed; give a file, or frames in a pipe")
    if not hasattr(sys.stdin, "buffer"):
        yield sys.stdin
        return
    stream = io.TextIOWrapper(sys.stdin.buffer, encoding="utf-8-sig", newline="")
    try:
        yield stream
    finally:
        stream.detach()


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    if path == STANDARD_INPUT:
        yield from _standard_input()
        return
    try:
        stream = path.open(encoding="utf-8-sig", newline="")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the name") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    with stream:
        yield stream

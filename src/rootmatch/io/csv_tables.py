"""CSV tables whose first row names the columns, with errors that name the file, the row and the remedy.

Rows are counted as an editor counts lines: the header is row 1. The text is UTF-8, with or without a byte-order mark
and with any line endings; blank lines are ignored. A row of separators alone is refused: a lost detection that were
ignored would move the numbers of all that follow. A header may begin with #, as `numpy.savetxt` writes it.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rootmatch.errors import InputError, quote_value
from rootmatch.io.inputs import LARGEST, read_bytes
from rootmatch.io.outputs import write_atomically

OTHER_NAMES = {
    "t": ("time",), "stamp": ("time",), "seconds": ("time",), "index": ("frame",), "image": ("frame",),
    "u": ("x",), "v": ("y",), "col": ("x",), "row": ("y",), "cam": ("camera",), "std": ("sigma",),
    "label": ("id", "body"),
}  # fmt: skip
"""Columns as other programs name them."""
_UNIT = re.compile(r"\s*[\[(].*[\])]$")


def read_text(path: Path, maximum: int = LARGEST, remedy: str = "split it") -> str:
    """The text of a file without a byte-order mark, line endings unchanged; `read_bytes` says what is refused."""
    try:
        return read_bytes(path, maximum, remedy).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: it is not UTF-8 text; save it as UTF-8") from None


def read_table(path: Path, needed: Sequence[str], known: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    """Rows of a table as (row number, {column: stripped text}); blank lines are ignored."""
    lines = io.StringIO(read_text(path), newline="")
    rows = [row for row in iterate_rows(path, lines, lambda header: needed, known) if row[1]]
    if not rows:
        raise InputError(f"{path}: the file is empty; give a header row {','.join(needed)} and one row per point")
    if len(rows) == 1:
        raise InputError(f"{path}: no row follows the header; give one row per point")
    return rows[1:]


def iterate_rows(
    path: Path, lines: Iterable[str], needed: Callable[[list[str]], Sequence[str]], known: Sequence[str]
) -> Iterator[tuple[int, dict[str, str]]]:
    """Each row as (row number, {column: stripped text}), the header first; a blank line has no columns.

    ``needed`` tells from the header which columns it must have.
    """
    reader = csv.reader(lines, strict=True, skipinitialspace=True)
    header: list[str] = []

    def where() -> str:
        return f"{path}, row {reader.line_num}"

    try:
        for raw in reader:
            cells = [cell.strip() for cell in raw]
            if not any(cells):
                if len(cells) > 1:
                    raise InputError(f"{where()}: a row of commas without values; fill it, or remove it")
                yield reader.line_num, {}
                continue
            if not header:
                first, cells = cells[0], parse_header(cells)
                header, expected = cells, ",".join(needed(cells))
                _refuse_separators(where(), cells, known, f"under a header row {expected}")
                if first.startswith("#") and not set(header) <= set(known):
                    raise InputError(
                        f"{where()}: a comment; remove the lines that begin with #, and start with a header {expected}"
                    )
                check_header(path, reader.line_num, header, needed(header), known)
            elif len(cells) != len(header):
                _refuse_separators(where(), cells)
                raise InputError(
                    f"{where()}: {len(cells)} values given, {len(header)} expected "
                    f"({','.join(needed(header))}); write a decimal point, not a comma, and fill every column"
                )
            yield reader.line_num, dict(zip(header, cells, strict=True))
    except csv.Error as error:
        raise InputError(f"{where()}: not comma-separated values ({error}); check the quotes") from None


def parse_header(cells: Iterable[str]) -> list[str]:
    """The names of the columns in the cells of a header, in lower case; a # before the first is none of its name."""
    names = [cell.strip().strip('"').lower() for cell in cells]
    return [names[0].removeprefix("#").strip(), *names[1:]]


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV table in UTF-8, moved into place when complete."""
    with write_atomically(path) as temporary:
        temporary.write_text(csv_text([header, *rows]), encoding="utf-8", newline="")


def csv_text(rows: Iterable[Sequence[Any]], delimiter: str = ",") -> str:
    """The lines of a table."""
    text = io.StringIO(newline="")
    csv.writer(text, delimiter=delimiter, lineterminator="\n").writerows(rows)
    return text.getvalue()


def parse_number(path: Path, row: int, column: str, text: str) -> float:
    """Parse the finite number of a cell, or raise an error that names it."""
    where = f"{path}, row {row}"
    if not text:
        raise InputError(f"{where}: {column} is empty; give a number, or remove the row")
    if not _is_number(text) or "_" in text:
        remedy = "the camera's index in the rig, from 0" if column == "camera" else "one such as 12.5"
        raise InputError(f"{where}: {column} is {quote_value(text)}, which is not a number; give {remedy}")
    value = float(text)
    if not math.isfinite(value):
        raise InputError(f"{where}: {column} is {quote_value(text)}; give a finite number, or remove the row")
    return value


def parse_nonnegative(path: Path, row: int, column: str, text: str) -> float:
    """Parse the number of a cell, 0 or more, such as a standard deviation."""
    value = parse_number(path, row, column, text)
    if value < 0.0:
        raise InputError(f"{path}, row {row}: {column} is {quote_value(text)}; give a number of 0 or more")
    return value


def refuse_repeats(
    path: Path, values: Sequence[tuple[int, Hashable]], what: str, remedy: str = "remove one of them"
) -> None:
    """Refuse a value that occurs in two rows."""
    first: dict[Hashable, int] = {}
    for row, value in values:
        if value in first:
            raise InputError(f"{path}, row {row}: the same {what} as in row {first[value]}; {remedy}")
        first[value] = row


def check_header(path: Path, row: int, header: list[str], needed: Sequence[str], known: Sequence[str]) -> None:
    """Refuse a header with missing, unknown or repeated columns, and suggest what was probably meant."""
    where = f"{path}, row {row}"
    expected = ",".join(needed)
    if "" in header:
        raise InputError(f"{where}: a column without a name; name it, or remove the comma at the end of each row")
    if all(_is_number(cell) for cell in header):
        raise InputError(f"{where}: numbers instead of column names; add a header row {expected}")
    repeated = [name for name in header if header.count(name) > 1]
    if repeated:
        raise InputError(f"{where}: the column {quote_value(repeated[0])} is named twice; name each column once")
    unknown = [name for name in header if name not in known]
    if unknown == ["z"]:
        raise InputError(f"{where}: a column z in an image, which has {expected}; are the two files swapped?")
    missing = [name for name in needed if name not in header]
    if missing:
        hint = (
            "; is it an image, and are the two files swapped?" if missing == ["z"] else _suggest_columns(unknown, known)
        )
        or_time = ", or time (in seconds) in the place of frame" if missing[0] == "frame" and "time" in known else ""
        raise InputError(
            f"{where}: the column {missing[0]!r} is missing, the header must name {expected}{or_time}{hint}"
        )
    if unknown:
        of_points = {"x", "y"} <= set(unknown)
        hint = "; is it a file of points or detections?" if of_points else _suggest_columns(unknown[:1], known)
        of_rig = ": a rig has several cameras, but this is a single one" if unknown[0] == "camera" else ""
        hint = hint or f"; remove it{of_rig}"
        raise InputError(
            f"{where}: the column {quote_value(unknown[0])} is unknown; known columns are {', '.join(known)}{hint}"
        )


def _suggest_columns(unknown: Sequence[str], known: Sequence[str]) -> str:
    """Which columns unknown names probably stand for: those of other programs, and misspelt ones."""
    from difflib import get_close_matches

    if {"sx", "sy"} & set(unknown) and "sxx" in known:
        return "; in a plane the noise is sigma, or a covariance sxx,sxy,syy"
    for name in unknown:
        plain = _UNIT.sub("", name)
        alike = (plain,) if plain in known else get_close_matches(name, known, 1)
        likely = [one for one in OTHER_NAMES.get(plain, alike) if one in known]
        if likely:
            more = ", in seconds" if likely == ["time"] else ""
            more = f", or to {likely[1]} if several rows share it" if likely == ["id", "body"] else more
            return f"; rename {quote_value(name)} to {likely[0]}{more}?"
    return ""


def _refuse_separators(where: str, cells: Sequence[str], known: Sequence[str] = (), and_more: str = "") -> None:
    """Refuse a row whose columns are not separated by commas; ``and_more``: what else a row of numbers lacks."""
    if len(cells) != 1:
        return
    words = cells[0].split()
    of_numbers = all(map(_is_number, words))
    in_columns = len(words) > 1 and all(word in known or _is_number(word) for word in words)
    for name, found in (("semicolons", ";" in cells[0]), ("tabs", "\t" in cells[0]), ("spaces", in_columns)):
        if found:
            more = f" {and_more}" if and_more and of_numbers else ""
            raise InputError(
                f"{where}: {name} between the columns; save with commas{more}, and decimal points in numbers"
            )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True

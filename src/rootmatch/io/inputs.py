"""Content of files, pipes and devices, never more of it than is needed."""

from __future__ import annotations

import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rootmatch.errors import InputError, quote_value

LARGEST = 100_000_000
"""Maximum size of a table of points in bytes; a million points take less."""


def read_bytes(path: Path, maximum: int = LARGEST, remedy: str = "split it") -> bytes:
    """The content of a file, pipe or device of at most ``maximum`` bytes."""
    with name_unreadable(path):
        if path.is_dir():
            raise InputError(f"{path}: it is a folder; give the name of a file")
        with path.open("rb") as stream:
            content = stream.read(maximum + 1)
    if len(content) > maximum:
        raise InputError(f"{path}: more than the {maximum:,} bytes that are read; {remedy}")
    return content


@contextmanager
def name_unreadable(path: Path) -> Iterator[None]:
    """Errors of opening and reading a file as one line that names it."""
    try:
        yield
    except OSError as error:
        if str(path).lstrip().startswith(("{", "[")):
            told = quote_value(str(path))
            raise InputError(f"{told}: no file has this name; write the JSON to a file, and give its name") from None
        if not isinstance(error, FileNotFoundError):
            raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
        raise InputError(f"{path}: there is no such file; check the name") from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: {error}; give the name of a file") from None


@contextmanager
def make_rereadable(path: Path) -> Iterator[Path]:
    """Yield a path that can be read again and again: of a pipe a copy, whose errors name the pipe."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        mode = stat.S_IFREG  # reading says what is wrong
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
        yield path
        return
    content = read_bytes(path)
    with tempfile.TemporaryDirectory(prefix="rootmatch-") as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(content)
        try:
            yield copy
        except InputError as error:
            raise InputError(str(error).replace(str(copy), str(path))) from None

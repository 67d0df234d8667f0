"""Output of results: files are written beside their destination and moved when complete; devices and pipes directly.

Every output of the package passes here. What stands at its path decides: a regular file, or nothing, gets a finished
file moved over it, through links to their target and with its mode and owner; a device, a pipe, or ``-`` for standard
output is sent the finished content; a folder, a socket or a disk is refused.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO

from rootmatch.errors import InputError

Writable = BinaryIO | FileIO
STANDARD_OUTPUT = Path("-")
PART = 1 << 20
"""Bytes that are sent through at a time."""
_DESCRIPTOR = re.compile(r"/(?:dev|proc/self)/fd/(\d{1,9})")
_REFUSED = (
    (stat.S_ISDIR, "is a folder; give the name of a file"),
    (stat.S_ISSOCK, "is a socket; give the name of a file"),
    (stat.S_ISBLK, "is a disk; give the name of a file on it"),
)


def check_output(path: Path, name: str, others: Iterable[Path] = ()) -> None:
    """Refuse, before any work, an output that cannot be written or is one of ``others``, inputs or other outputs."""
    try:
        through = is_written_through(path)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    if not through:
        folder = Path(os.path.realpath(path)).parent
        if not folder.is_dir():
            raise InputError(f"{name}: the folder {path.parent} does not exist; create it first")
        if not os.access(folder, os.W_OK):
            raise InputError(f"{name}: the folder {path.parent} cannot be written to; choose another")
    elif _find_descriptor(path) is None and stat.S_ISCHR(path.stat().st_mode):
        return  # /dev/null takes any number of outputs
    for other in others:
        if is_same_file(path, other):
            raise InputError(f"{name}: {path} is also an input or another output; choose another name")


def is_written_through(path: Path) -> bool:
    """Whether content is sent to what stands at a path, as to a device, instead of a new file being moved there.

    Raises `InputError` if nothing can be written there: a folder, a socket, a disk, something that is read-only.
    """
    if _find_descriptor(path) is not None:
        return True
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be written ({reason}); choose another name") from None
    for is_one, refusal in _REFUSED:
        if is_one(mode):
            raise InputError(f"{path} {refusal}")
    if not os.access(path, os.W_OK):
        raise InputError(f"{path} is read-only; choose another name, or change its permissions")
    # a file in a folder that takes no other keeps its place
    return not stat.S_ISREG(mode) or not os.access(os.path.dirname(os.path.realpath(path)), os.W_OK)


def is_standard_output(path: Path) -> bool:
    """Whether a path names standard output, or the file or pipe that standard output is."""
    return _find_descriptor(path) == 1


def is_same_file(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file, whatever links are between."""
    if _find_descriptor(one) is not None or _find_descriptor(other) is not None:
        return _find_descriptor(one) == _find_descriptor(other)
    if os.path.realpath(one) == os.path.realpath(other):
        return True
    try:
        return os.path.samefile(one, other)
    except (OSError, ValueError):
        return False


@contextmanager
def write_atomically(path: Path) -> Iterator[Path]:
    """Yield a temporary path; its content gets to ``path`` at the end, and nothing is left after an error."""
    temporary = None
    try:
        through = is_written_through(path)
        folder = Path(tempfile.gettempdir() if through else os.path.dirname(os.path.realpath(path)))
        temporary = folder / f".{path.stem[:40]}-{secrets.token_hex(4)}{path.suffix[:20]}"
        if through:  # for the eyes of nobody else meanwhile
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        yield temporary
        _move_or_send(temporary, path)
    except InputError as error:  # of what is written inside, which only knows the temporary name
        raise InputError(str(error).replace(str(temporary), str(path))) from None
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another location") from None
    finally:
        try:
            _discard(temporary)
        finally:  # Ctrl-C may strike just there
            _discard(temporary)


def write_text_atomically(path: Path, text: str) -> None:
    """Write a text in UTF-8, moved into place when complete."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def open_sink(path: Path) -> Iterator[Writable]:
    """Yield the device, pipe or file at a path for writing, standard output in order with what is printed."""
    number = _find_descriptor(path)
    stream: Any = {1: sys.stdout, 2: sys.stderr}.get(number or 0)
    if stream is not None and hasattr(stream, "buffer"):
        stream.flush()
        yield stream.buffer
        stream.flush()
    elif number is not None:
        with os.fdopen(os.dup(number), "wb", buffering=0) as sink:
            yield sink
    else:
        with path.open("wb", buffering=0) as sink:
            yield sink


def write_all(sink: Writable, content: bytes) -> None:
    """Write the whole content, which one call of an unbuffered file may not."""
    left = memoryview(content)
    while left:
        left = left[sink.write(left) or 0 :]


def check_output_folder(path: Path, force: bool = False) -> None:
    """Refuse, before any work, a folder that cannot be created or, unless ``force``, is not empty."""
    try:
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: it is a file; give the name of a folder")
        if path.is_dir() and any(path.iterdir()) and not force:
            raise InputError(f"{path}: the folder is not empty; choose another, or replace its files with --force")
        if not Path(os.path.realpath(path)).parent.is_dir():
            raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")
    except OSError as error:
        raise InputError(f"{path}: cannot be used ({error.strerror}); choose another location") from None


@contextmanager
def write_folder_atomically(path: Path, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder next to ``path``, moved there at the end, or removed on any error.

    An existing folder is kept: files of the same name are replaced one by one, others are left alone.
    """
    check_output_folder(path, force)
    place = Path(os.path.realpath(path))
    temporary = place.with_name(f".{place.name[:40]}-{secrets.token_hex(4)}")
    try:
        temporary.mkdir()
        yield temporary
        if place.is_dir():
            files = sorted(temporary.iterdir())
            for file in files:  # all of them before the first is replaced
                is_written_through(place / file.name)
            for file in files:
                _move_or_send(file, place / file.name)
        else:
            os.replace(temporary, place)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another location") from None
    finally:
        try:
            shutil.rmtree(temporary, ignore_errors=True)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _find_descriptor(path: Path) -> int | None:
    """The open file that a path stands for, if it does; files and pipes that standard output or error goes to count."""
    if path == STANDARD_OUTPUT or str(path) == "/dev/stdout":
        return 1
    if str(path) == "/dev/stderr":
        return 2
    if named := _DESCRIPTOR.fullmatch(str(path)):
        return int(named[1])
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    if stat.S_ISREG(found.st_mode) or stat.S_ISFIFO(found.st_mode):
        for number in (1, 2):
            try:
                if os.path.samestat(found, os.fstat(number)):
                    return number
            except OSError:  # closed
                continue
    return None


def _move_or_send(content: Path, path: Path) -> None:
    """Bring a finished file to a path: moved there with the mode and owner of what it replaces, or sent through."""
    if is_written_through(path):
        _send(content, path)
        return
    place = os.path.realpath(path)
    try:
        if os.path.exists(place):
            _copy_owner_and_mode(content, os.stat(place))
        os.replace(content, place)
    except OSError as error:
        # of another user, or mounted by itself as in a container: it keeps its place
        if not os.path.exists(place) or error.errno not in (errno.EPERM, errno.EBUSY):
            raise
        _send(content, path)


def _copy_owner_and_mode(content: Path, old: os.stat_result) -> None:
    """Give a file the owner and mode of another one."""
    new = os.stat(content)
    if (new.st_uid, new.st_gid) != (old.st_uid, old.st_gid):
        os.chown(content, old.st_uid, old.st_gid)
    if stat.S_IMODE(new.st_mode) != stat.S_IMODE(old.st_mode):
        os.chmod(content, stat.S_IMODE(old.st_mode))


def _send(content: Path, path: Path) -> None:
    with content.open("rb") as source, open_sink(path) as sink:
        while part := source.read(PART):
            write_all(sink, part)


def _discard(temporary: Path | None) -> None:
    if temporary is not None:
        with suppress(OSError):
            temporary.unlink()

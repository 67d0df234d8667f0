"""Atomic output: files and folders are written under a temporary name next to their destination, then moved there."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rootmatch.errors import InputError


def check_output(path: Path, name: str, others: Iterable[Path] = ()) -> None:
    """Refuse, before any work, an output that is a folder, has no folder to go to, or is one of ``others``."""
    if path.is_dir():
        raise InputError(f"{name}: {path} is a folder; give the name of a file")
    if not path.parent.is_dir():
        raise InputError(f"{name}: the folder {path.parent} does not exist; create it first")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{name}: the folder {path.parent} cannot be written to; choose another")
    for other in others:
        if other.resolve() == path.resolve():
            raise InputError(f"{name}: {path} is also an input or another output; choose another name")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to ``path``; its file is moved to ``path``, or removed on any error."""
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except InputError as error:  # of what is written inside, which only knows the temporary name
        raise InputError(str(error).replace(str(temporary), str(path))) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another location") from None
    finally:
        try:
            temporary.unlink(missing_ok=True)
        finally:  # Ctrl-C may strike just there
            temporary.unlink(missing_ok=True)


def check_output_folder(path: Path, force: bool = False) -> None:
    """Refuse, before any work, a folder that cannot be created or, unless ``force``, is not empty."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: it is a file; give the name of a folder")
    if path.is_dir() and any(path.iterdir()) and not force:
        raise InputError(f"{path}: the folder is not empty; choose another, or replace its files with --force")
    if not path.resolve().parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")


@contextmanager
def folder_written_whole(path: Path, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder next to ``path``, moved there at the end, or removed on any error.

    An existing folder is kept: files of the same name are replaced one by one, others are left alone.
    """
    check_output_folder(path, force)
    place = path.resolve()
    temporary = place.with_name(f".{place.name}-{secrets.token_hex(4)}")
    try:
        temporary.mkdir()
        yield temporary
        if place.is_dir():
            for file in sorted(temporary.iterdir()):
                os.replace(file, place / file.name)
        else:
            os.replace(temporary, place)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another location") from None
    finally:
        try:
            shutil.rmtree(temporary, ignore_errors=True)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

"""Files of a report: whole or not at all, an old one kept until the new one is there."""

from __future__ import annotations

import os
from pathlib import Path

from rootmatch.errors import InputError


def put(path: Path, content: bytes) -> None:
    """Write a file under a temporary name next to it, and move it there.

    Raises
    ------
    InputError
        If it cannot be written; the old file is kept then.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); free room, or name another folder") from None
    finally:
        part.unlink(missing_ok=True)

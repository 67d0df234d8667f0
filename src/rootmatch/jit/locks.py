"""A lock between processes, so that no two of them compile the same at once."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: two processes may compile the same, and one of them in vain
    fcntl = None  # type: ignore[assignment]


class FileLock:
    """A lock beside a file; the system releases it should the process die."""

    def __init__(self, path: Path, handle: int) -> None:
        self.path, self.handle = path, handle

    @classmethod
    def taken(cls, file: Path) -> FileLock | None:
        """The lock for a file to be written, once no other process holds it; None if the system has no locks."""
        if fcntl is None:
            return None
        path = file.with_suffix(".lock")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:
            return None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
        except OSError:
            os.close(handle)
            return None
        except BaseException:  # Ctrl-C while waiting
            os.close(handle)
            raise
        return cls(path, handle)

    def release(self) -> None:
        """Release the lock and delete its file; a waiting process then checks again whether anything is left to do."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
        os.close(self.handle)

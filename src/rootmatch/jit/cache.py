"""What Numba has compiled already, in this process or on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rootmatch.jit.fallback import MISSING


def is_compiled(kernel: Any) -> bool:
    """Whether a jitted function with ``cache=True`` has been compiled, for any types.

    True as well where Numba does not tell: who asks would compile ahead of need, which can be left.
    """
    try:
        if kernel.signatures:
            return True
        folder, file = Path(kernel.stats.cache_path or ""), Path(kernel.py_func.__code__.co_filename)
        return next(folder.glob(f"{file.stem}.{kernel.__name__}-*.nbi"), None) is not None
    except MISSING:
        return True

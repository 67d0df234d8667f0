"""Compiled code on disk: what Numba has compiled already, and what to do with a cache that cannot be read.

Numba unpickles what it finds. A file that an earlier version of the package has left, whose modules have other names
by now, or one that is cut short, would end the first call with an error from inside pickle. Here it counts as missing.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba import njit

from rootmatch.jit.fallback import MISSING, warn_lost


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


try:
    from numba.core.caching import FunctionCache

    class TolerantCache(FunctionCache):
        """The cache of one function, which is compiled anew where the cache cannot be read."""

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            """The compiled function, None where there is none or it cannot be read."""
            try:
                return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            except Exception:  # pickle runs what it reads: anything can come of a damaged file
                self.flush()  # type: ignore[no-untyped-call]
                return None

        def save_overload(self, sig: Any, data: Any) -> None:
            """Keep a compiled function where there is room for it: a full disk ends no match."""
            with suppress(OSError):
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    AVAILABLE = True
except MISSING as error:
    AVAILABLE = False
    warn_lost("a damaged cache of compiled code ends a match; delete it then", error)


def kept_on_disk(options: dict[str, Any]) -> Callable[[Callable[..., Any]], Any]:
    """Decorator as `numba.njit` with ``cache=True``; without a cache where no folder for it can be written."""

    def decorated(function: Callable[..., Any]) -> Any:
        try:
            made: Any = njit(cache=True, **options)(function)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            return njit(**options)(function)
        if AVAILABLE and hasattr(made, "_cache"):
            made._cache = TolerantCache(function)  # type: ignore[no-untyped-call]
        return made

    return decorated

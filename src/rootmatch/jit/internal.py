"""Functions that jitted code calls and Python hardly ever does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import config, njit

from rootmatch.jit.fallback import MISSING, warn_lost
from rootmatch.jit.options import check

WITHOUT_ENTRIES = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

try:
    from numba.core.registry import CPUDispatcher

    class InternalDispatcher(CPUDispatcher):
        """A jitted function without the entries by which Python and C would call it.

        They take half of the time to compile a small function, and each of them would hold a copy of all that is
        inlined. Called from Python all the same, it is compiled for that apart.
        """

        asked: dict[str, Any]
        outer: Callable[..., Any] | None = None

        def __call__(self, *arguments: Any) -> Any:
            """As from jitted code."""
            if self.outer is None:
                self.outer = njit(**self.asked)(self.py_func)
            return self.outer(*arguments)

    check(**WITHOUT_ENTRIES)
    InternalDispatcher(lambda: None, targetoptions={"nopython": True, "boundscheck": None, **WITHOUT_ENTRIES})
    AVAILABLE = True
except MISSING as error:
    AVAILABLE = False
    warn_lost("every jitted function is compiled for Python too: the first match takes longer", error)


def internal(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator as `numba.njit` with these options, for what jitted code calls; nothing is kept on disk of it alone."""

    def decorated(function: Callable[..., Any]) -> Any:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            return function
        if AVAILABLE:
            made = InternalDispatcher(
                function, targetoptions={"nopython": True, "boundscheck": None, **options, **WITHOUT_ENTRIES}
            )
        else:
            made = njit(**options)(function)
        made.asked = options
        return made

    return decorated

"""Options of `numba.njit` that Numba has but does not document."""

from __future__ import annotations

from typing import Any

from numba import njit

from rootmatch.jit.fallback import MISSING, warn_lost


def check(**options: Any) -> None:
    """Raise one of `MISSING` where Numba does not know these options."""
    from numba.core import compiler

    insides: Any = compiler
    jitted: Any = njit(lambda: None)
    jitted.targetdescr.options.parse_as_flags(insides.Flags(), options)


FORCED: dict[str, Any] = {"forceinline": True}
"""Options of what LLVM has to inline; none where Numba cannot force it."""

try:
    check(**FORCED)
except MISSING as error:
    FORCED = {}
    warn_lost("kernels need not be inlined: sweeps may be slower, and their last digits may change", error)


FOR_PYTHON_ALONE: dict[str, Any] = {"no_cfunc_wrapper": True}
"""Options of what Python calls and C does not: a twentieth of the time to compile it; none where Numba has no such."""

try:
    check(**FOR_PYTHON_ALONE)
except MISSING:
    FOR_PYTHON_ALONE = {}

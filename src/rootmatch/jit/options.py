"""Options of `numba.njit` that Numba has but does not document."""

from __future__ import annotations

from typing import Any

FORCED: dict[str, Any] = {"forceinline": True}
"""Options of what LLVM has to inline."""
FOR_PYTHON_ALONE: dict[str, Any] = {"no_cfunc_wrapper": True}
"""Options of what Python calls and C does not: a twentieth of the time to compile it."""
WITHOUT_ENTRIES: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of what neither calls."""

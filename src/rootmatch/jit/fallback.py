"""Fallbacks where Numba lacks an internal that it never promised: a warning says once what is lost.

Each module of this package that uses such an internal sets it up when it is imported. If that fails, the module uses
what Numba documents instead. Matches are the same; one warning says what is lost.
"""

from __future__ import annotations

import warnings

import numba

MISSING = (ImportError, AttributeError, TypeError, KeyError, ValueError, NotImplementedError)
"""What the set-up raises if an internal is gone, has moved or has other parameters."""


class JitFallbackWarning(RuntimeWarning):
    """An internal of Numba is missing: results are right, but something else is lost, mostly time."""


def warn_lost(loss: str, error: Exception) -> None:
    """Warn of what is lost without an internal, and say what to do; silent where compilation is switched off."""
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return
    warnings.warn(
        f"Numba {numba.__version__} lacks an internal that rootmatch uses ({type(error).__name__}: {error}). Matching "
        f"works, but {loss}. Install a version of Numba that rootmatch's dependencies allow.",
        JitFallbackWarning,
        stacklevel=3,
    )

"""What is done where Numba lacks something that it never promised: without it, and with one warning of the cost.

Each module of this package that uses such an inside sets it up when it is imported. Should that fail, it takes what
Numba documents instead. Matches are the same; what is lost is told once.
"""

from __future__ import annotations

import warnings

import numba

MISSING = (ImportError, AttributeError, TypeError, KeyError, ValueError, NotImplementedError)
"""What the set-up raises where an inside is gone, has moved or has other parameters."""


class JitFallbackWarning(RuntimeWarning):
    """An inside of Numba is missing: results are right, something else is lost."""


def warn_lost(loss: str, error: Exception) -> None:
    """Tell what is lost with an inside, and what to do; nothing where compilation is switched off."""
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return
    warnings.warn(
        f"Numba {numba.__version__} lacks an inside that rootmatch uses ({type(error).__name__}: {error}). Matching "
        f"works, but {loss}. Install a version of Numba that rootmatch's dependencies allow.",
        JitFallbackWarning,
        stacklevel=3,
    )

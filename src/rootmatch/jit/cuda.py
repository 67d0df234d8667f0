"""The kernels' choices by type made known to numba-cuda, as `rootmatch.jit.dispatch` makes them known to Numba.

Imported only when a card is asked for.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numba
import numpy as np
from numba import cuda, types

from rootmatch.errors import InputError
from rootmatch.jit.dispatch import OVERLOADS

SIMULATED: bool = bool(cuda.config.ENABLE_CUDASIM) if hasattr(cuda, "config") else False
"""Whether Numba's simulator stands in for a card (``NUMBA_ENABLE_CUDASIM=1``)."""

_known: set[Any] = set()


def register_kernels() -> None:
    """Tell numba-cuda which kernel serves which types.

    Raises `InputError` where numba-cuda cannot be told: a kernel has to be chosen by type, so nothing runs on the card;
    and where it cannot compile at all.
    """
    if SIMULATED:
        return
    try:
        # the first kernel imports it; that of numba-cuda 0.30 asks for a function that NumPy 2.5 no longer has
        import_module("numba.cuda.cudaimpl")
        from numba.cuda.extending import overload

        if not _known:
            _register_root()
        for function, choice in OVERLOADS:
            if function not in _known:
                overload(function)(choice)
                _known.add(function)
    except (ImportError, AttributeError, TypeError) as error:
        raise InputError(
            f'backend: "cuda" needs overloads of numba-cuda, which this version lacks with Numba {numba.__version__} '
            f"and NumPy {np.__version__} ({type(error).__name__}: {error}); install another version of numba-cuda or "
            'NumPy, or use "cpu"'
        ) from error


def _register_root() -> None:
    """numba-cuda knows the root of `math` only."""
    from numba.cuda.extending import lower_builtin

    @lower_builtin(np.sqrt, types.Float)
    def _sqrt(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.get_function(math.sqrt, signature)(builder, arguments)

"""Decorators of kernels: how they are compiled, and where they are inlined."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rootmatch.jit.cache import keep_on_disk
from rootmatch.jit.internal import internal_function
from rootmatch.jit.options import FORCED

FASTMATH = {"contract", "arcp", "nsz", "reassoc"}
"""Reordering and fused products are welcome; NaN and infinity keep their meaning where kernels compare with them.

`math.isfinite` is none: it is compiled as x − x, which reordering takes for zero. Ask for ``abs(x) < math.inf``.
"""


scalar = internal_function(fastmath=FASTMATH, error_model="numpy", **FORCED)
"""Decorator of scalar kernels: straight-line arithmetic that LLVM inlines, and vectorises in the loop around it."""


kernel = internal_function(fastmath=FASTMATH, error_model="numpy", **FORCED)
"""Decorator of what loops: row kernels and large scalars.

Inlined too, into the driver: a function of its own would be there twice, optimised apart, and a process that has just
compiled the driver would call the other copy than one that found it on disk, which differs in the last digits.
"""


part = internal_function(fastmath=FASTMATH, error_model="numpy")
"""Decorator of what LLVM may inline or call: pieces of the search, whose loop a large body would slow by two thirds."""


def driver(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of what Python calls: as `numba.njit` with these options, kept on disk (`rootmatch.jit.cache`)."""
    return keep_on_disk(options)

"""The kernels of a guided search, selected by the type of a problem's tables while a driver is compiled.

One driver serves all problems and is found again in the on-disk cache; see `rootmatch.problems.residual_dispatch`.
"""

from __future__ import annotations

from typing import Any

from rootmatch.jit.dispatch import dispatch_to_kernel
from rootmatch.problems.kernels import HypothesisKernels, ListedKernels, kernel_record


def hypothesis_kernels(tables: Any) -> HypothesisKernels:
    """The kernels of some tables, or of their Numba type, which must have them."""
    kernels = kernel_record(tables).hypotheses
    if kernels is None:
        raise TypeError(f"{tables}: no kernels for a guided search; ask has_hypotheses() first")
    return kernels


def has_hypotheses(tables: Any) -> bool:
    """Whether some tables have the kernels for a guided search."""
    return kernel_record(tables).hypotheses is not None


def listed_kernels(tables: Any) -> ListedKernels:
    """The kernels for listed image triples, which must be there."""
    kernels = hypothesis_kernels(tables).listed
    if kernels is None:
        raise TypeError(f"{tables}: no kernels for listed image triples; ask has_listed() first")
    return kernels


def has_listed(tables: Any) -> bool:
    """Whether some tables have the kernels for listed image triples."""
    kernels = kernel_record(tables).hypotheses
    return kernels is not None and kernels.listed is not None


# see `HypothesisKernels`
solve_set = dispatch_to_kernel(hypothesis_kernels, "solve")
set_known = dispatch_to_kernel(hypothesis_kernels, "known")
set_frame = dispatch_to_kernel(hypothesis_kernels, "frame")
predict_set = dispatch_to_kernel(hypothesis_kernels, "predict")
# see `ListedKernels`
gather_listed = dispatch_to_kernel(listed_kernels, "gather")
solve_listed = dispatch_to_kernel(listed_kernels, "solve")
listed_frame = dispatch_to_kernel(listed_kernels, "frame")

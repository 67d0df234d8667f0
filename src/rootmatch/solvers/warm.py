"""The kernels of the default solver, compiled ahead of need: the first time takes seconds, and other work can go on."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rootmatch.kernels.support import supported_answers
from rootmatch.solvers import local_search
from rootmatch.solvers.ascent import MultiStartAscent
from rootmatch.tensor import AffinityTensor


def is_cold() -> bool:
    """Whether the largest kernel of the ascent is not in Numba's cache on disk, nor compiled by now."""
    kernel = local_search._ascend
    if kernel.signatures:
        return False
    folder = Path(kernel.stats.cache_path or "")
    return next(folder.glob(f"{Path(local_search.__file__).stem}._ascend-*.nbi"), None) is None


def warm(*orders: int) -> None:
    """Compile, by the solution of a small tensor of each order. The types are the same for every problem and size."""
    rng = np.random.default_rng(0)
    shape, count = (6, 7), 2000
    # tensors of order 3 have a few kernels of their own
    for order in orders or (4, 3):
        sources = np.argsort(rng.random((count, shape[0])), axis=1)[:, :order]
        targets = np.argsort(rng.random((count, shape[1])), axis=1)[:, :order]
        indices = (sources * shape[1] + targets).astype(np.int32)
        tensor = AffinityTensor.unchecked(indices, rng.random(count), shape)
        answer = MultiStartAscent()(tensor).assignment
        supported_answers(indices, tensor.weights, None, shape[1], answer[None], 0.1)

"""What the kernel of the zoom reads of the two point sets, and the record of that kernel."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.jit.decorators import kernel
from rootmatch.problems.kernels import ProblemKernels, ResidualKernels
from rootmatch.problems.residual_kinds import Joint


@kernel
def edge(t, kind, i, j):
    """√χ² of three correspondences: differences to the first, whose noise they share, the scale projected out."""
    across = along = own = 0.0
    for axis in range(2):
        x, y = t.source[axis], t.target[axis]
        d1, d2 = x[i[1]] - x[i[0]], x[i[2]] - x[i[0]]
        e1, e2 = y[j[1]] - y[j[0]], y[j[2]] - y[j[0]]
        own += d1 * d1 - d1 * d2 + d2 * d2
        along += d1 * e1 - 0.5 * (d1 * e2 + d2 * e1) + d2 * e2
        across += e1 * e1 - e1 * e2 + e2 * e2
    variance = (t.variance[j[0]] + t.variance[j[1]] + t.variance[j[2]]) / 3.0
    return math.sqrt(max(across - along * along / own, 0.0) / (1.5 * variance))


@kernel
def slab(t, kind, i, j, first, scratch, out):
    for r in range(out.shape[0]):
        for last in range(out.shape[1]):
            out[r, last] = edge(t, kind, (i[0], i[1], first + r), (j[0], j[1], last))


KERNELS = ProblemKernels(residuals={Joint: ResidualKernels(edge, slab)})


class ZoomTables(NamedTuple):
    """What the kernel reads."""

    source: NDArray[np.float64]
    """(2, n)."""
    target: NDArray[np.float64]
    """(2, n')."""
    variance: NDArray[np.float64]
    """(n',)."""

    @staticmethod
    def kernels() -> ProblemKernels:
        """The record of the problem."""
        return KERNELS

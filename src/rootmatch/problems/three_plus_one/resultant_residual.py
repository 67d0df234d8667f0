"""The paper's residuals of a 3P1 hyper-edge: of the resultant of two quartics, without regard to the noise."""

from __future__ import annotations

from typing import Any

from rootmatch.algebra.vector import column
from rootmatch.jit.decorators import kernel
from rootmatch.problems.kernels import ResidualKernels
from rootmatch.problems.pairs import edge_kernel_of_pairs, slab_kernel_of_edges
from rootmatch.problems.three_plus_one.quartic import branch, coefficients, stem


def resultant_kernels(value: Any) -> ResidualKernels:
    """Edge and slab kernels of a residual that compares the quartics alone."""

    @kernel
    def pair(tables, i, j, order):  # type: ignore[no-untyped-def]
        q, p = tables.source, tables.target
        a, b, c, d = order
        trunk = stem(column(q, i[a]), column(p, j[a]), column(q, i[b]), column(p, j[b]))
        h4, h3, h2, h1, h0 = coefficients(branch(trunk, column(q, i[c])), column(p, j[c]))
        f4, f3, f2, f1, f0 = coefficients(branch(trunk, column(q, i[d])), column(p, j[d]))
        return value(h4, h3, h2, h1, h0, f4, f3, f2, f1, f0)

    edge = edge_kernel_of_pairs(pair, 3)
    several = slab_kernel_of_edges(edge)

    @kernel
    def slab(tables, kind, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
        if kind.pairs != 1:
            several(tables, kind, i, j, first, out)
            return
        q, p = tables.source, tables.target
        x, y, z = p[0], p[1], p[2]
        trunk = stem(column(q, i[0]), column(p, j[0]), column(q, i[1]), column(p, j[1]))
        h4, h3, h2, h1, h0 = coefficients(branch(trunk, column(q, i[2])), column(p, j[2]))
        for r in range(out.shape[0]):
            line = out[r]
            g = branch(trunk, column(q, first + r))
            for n in range(line.shape[0]):
                f4, f3, f2, f1, f0 = coefficients(g, (x[n], y[n], z[n]))
                line[n] = value(h4, h3, h2, h1, h0, f4, f3, f2, f1, f0)

    return ResidualKernels(edge, slab)

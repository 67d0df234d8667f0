"""The paper's residuals of an up2p hyper-edge: of the resultant of two quadratics, without regard to the noise."""

from __future__ import annotations

from typing import Any

from rootmatch.algebra.vector import column, difference
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.kernels import ResidualKernels
from rootmatch.problems.pairs import edge_kernel_of_pairs, slab_kernel_of_rows
from rootmatch.problems.up2p.quadratic import quadratic


@scalar
def pair_quadratic(t, i0, i1, j0, j1):  # type: ignore[no-untyped-def]
    """The quadratic of the correspondences (i0, j0) and (i1, j1)."""
    between = difference(column(t.points, i1), column(t.points, i0))
    return quadratic(between, column(t.rays, j0), column(t.rays, j1))


def resultant_kernels(value: Any) -> ResidualKernels:
    """Edge and slab kernels of a residual that compares the quadratics alone."""

    @scalar
    def pair(t, i, j, order):  # type: ignore[no-untyped-def]
        a, b, c = order
        p2, p1, p0 = pair_quadratic(t, i[a], i[b], j[a], j[b])
        q2, q1, q0 = pair_quadratic(t, i[a], i[c], j[a], j[c])
        return value(p2, p1, p0, q2, q1, q0)

    @kernel
    def row(t, i, j, last, line):  # type: ignore[no-untyped-def]
        u = t.rays
        between, a = difference(column(t.points, last), column(t.points, i[0])), column(u, j[0])
        p2, p1, p0 = pair_quadratic(t, i[0], i[1], j[0], j[1])
        x, y, z = u[0], u[1], u[2]
        for k in range(line.shape[0]):
            q2, q1, q0 = quadratic(between, a, (x[k], y[k], z[k]))
            line[k] = value(p2, p1, p0, q2, q1, q0)

    edge = edge_kernel_of_pairs(pair, 2)
    return ResidualKernels(edge, slab_kernel_of_rows(row, edge))

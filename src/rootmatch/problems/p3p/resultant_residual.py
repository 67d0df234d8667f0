"""The paper's residuals of a P3P hyper-edge: of the resultant of two quartics, without regard to the noise.

A hyper-edge (a, b, c, d) joins the triples abc and abd, whose quartics share x = b/a.
"""

from __future__ import annotations

from typing import Any

from rootmatch.algebra.any_degree import NO_INFORMATION, make_singular_value_kernel
from rootmatch.algebra.bezout import make_last_entry_kernel, make_lesser_entry_kernel
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.kernels import ResidualKernels
from rootmatch.problems.p3p.quartic import quartic_about_one, quartic_in_ratio
from rootmatch.problems.pairs import edge_kernel_of_pairs, slab_kernel_of_rows

COINCIDENT = 1e-20
"""Versine of the angle below which two bearings are one: 1e-10 rad, below the rounding of any pixel; not tuned."""

unit_singular_value = make_singular_value_kernel(4)


@scalar
def are_bearings_distinct(hab, hbc, hca, hbd, hda):  # type: ignore[no-untyped-def]
    """Whether no two bearings are one: there x = 1 solves every quartic, and agreement says nothing."""
    return min(min(hab, hbc, hca), min(hbd, hda)) > COINCIDENT


def residual_of_quartics(compare: Any) -> Any:
    """A residual of the two quartics in x, as in the paper, from a kernel that compares their forms about x = 1."""

    @scalar
    def entry(A, B, C, B2, C2, hab, hbc, hca, hbd, hda):  # type: ignore[no-untyped-def]
        p4, p3, p2, p1, p0 = quartic_about_one(A, B, C, hab, hbc, hca)
        q4, q3, q2, q1, q0 = quartic_about_one(A, B2, C2, hab, hbd, hda)
        value = compare(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0)
        return value if are_bearings_distinct(hab, hbc, hca, hbd, hda) else NO_INFORMATION

    return entry


last_entry = residual_of_quartics(make_last_entry_kernel(4, about_one=True))
lesser_last_entry = residual_of_quartics(make_lesser_entry_kernel(4, about_one=True))


@scalar
def singular_value(A, B, C, B2, C2, hab, hbc, hca, hbd, hda):  # type: ignore[no-untyped-def]
    """Least singular value of the 8×8 Sylvester matrix of the two quartics in x."""
    p4, p3, p2, p1, p0 = quartic_in_ratio(A, B, C, hab, hbc, hca)
    q4, q3, q2, q1, q0 = quartic_in_ratio(A, B2, C2, hab, hbd, hda)
    return unit_singular_value(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0)


def resultant_kernels(value: Any) -> ResidualKernels:
    """Edge and slab kernels of a residual that compares the quartics alone."""

    @scalar
    def pair(t, i, j, order):  # type: ignore[no-untyped-def]
        s, h = t.distance2, t.versine
        a, b, c, d = i[order[0]], i[order[1]], i[order[2]], i[order[3]]
        k, l, m, n = j[order[0]], j[order[1]], j[order[2]], j[order[3]]  # noqa: E741
        return value(s[a, b], s[b, c], s[a, c], s[b, d], s[a, d], h[k, l], h[l, m], h[k, m], h[l, n], h[k, n])

    @kernel
    def row(t, i, j, d, line):  # type: ignore[no-untyped-def]
        s, h = t.distance2, t.versine
        A, B, C, B2, C2 = s[i[0], i[1]], s[i[1], i[2]], s[i[0], i[2]], s[i[1], d], s[i[0], d]
        hab, hbc, hca = h[j[0], j[1]], h[j[1], j[2]], h[j[0], j[2]]
        hbd, hda = h[j[1]], h[j[0]]
        for k in range(line.shape[0]):
            line[k] = value(A, B, C, B2, C2, hab, hbc, hca, hbd[k], hda[k])

    edge = edge_kernel_of_pairs(pair, 3)
    return ResidualKernels(edge, slab_kernel_of_rows(row, edge))

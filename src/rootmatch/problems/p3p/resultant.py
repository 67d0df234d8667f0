"""Kernels of the perspective three-point problem: the quartic of a triple and the residuals of a 4-tuple.

A hyper-edge (a, b, c, d) joins the triples abc and abd, whose quartics share x = b/a, the ratio of two depths (paper,
section "Three-point Calibrated Absolute Pose Problem"). Everything is computed from squared distances and from
h = 1 − cos of the angle between two bearings: cameras are far from their points, so cosines crowd about 1 and
differences of them would lose half of the digits. This file has the quartic and the paper's residuals; the roots are in
``p3p_roots``, the residuals in units of the noise in ``p3p_normalised`` and ``p3p_joint``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rootmatch.algebra.bezout import (
    NO_INFORMATION,
    lesser_unit_last_entry_quartic_about_one,
    unit_last_entry_quartic_about_one,
)
from rootmatch.algebra.sylvester import smallest_singular_value_quartic
from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.kernels import ResidualKernels
from rootmatch.problems.residual_dispatch import slab_of_rows

STEP = 0.3
"""x = 1 + STEP z. At the paper's ranges |z| stays below 1, where the Bézout matrix is well scaled."""
LARGE = 1e6
"""The residual of a hyper-edge that says nothing: no information is not agreement."""
COINCIDENT = 1e-20
"""Versine of the angle below which two bearings are one."""


@scalar
def quadratics(A, B, C, hp, hq, hr, step):  # type: ignore[no-untyped-def]
    """N, D, M of a triple as coefficients in z, x = 1 + step z: (n2, n1, n0, d1, d0, m2, m1, m0)."""
    inverse = 1.0 / A
    u = (B - C) * inverse
    v = C * inverse
    n2 = (u - 1.0) * step * step
    n1 = 2.0 * step * (u * hp - 1.0)
    n0 = 2.0 * u * hp
    d1 = (hq - 1.0) * step
    d0 = hq - hr
    m2 = -v * step * step
    m1 = -2.0 * v * hp * step
    m0 = 1.0 - 2.0 * v * hp
    return n2, n1, n0, d1, d0, m2, m1, m0


@scalar
def quartic(n2, n1, n0, d1, d0, m2, m1, m0, hr):  # type: ignore[no-untyped-def]
    """Coefficients of N² − 4 r N D + 4 D² M, highest degree first."""
    r4 = 4.0 * (1.0 - hr)
    s2 = 4.0 * d1 * d1
    s1 = 8.0 * d1 * d0
    s0 = 4.0 * d0 * d0
    q4 = n2 * n2 + s2 * m2
    q3 = 2.0 * n2 * n1 - r4 * n2 * d1 + s2 * m1 + s1 * m2
    q2 = n1 * n1 + 2.0 * n2 * n0 - r4 * (n2 * d0 + n1 * d1) + s2 * m0 + s1 * m1 + s0 * m2
    q1 = 2.0 * n1 * n0 - r4 * (n1 * d0 + n0 * d1) + s1 * m0 + s0 * m1
    q0 = n0 * n0 - r4 * n0 * d0 + s0 * m0
    return q4, q3, q2, q1, q0


@scalar
def quartic_about_one(A, B, C, hp, hq, hr):  # type: ignore[no-untyped-def]
    """The paper's quartic in x by powers of x − 1, which loses no digits where its roots crowd about 1."""
    n2, n1, n0, d1, d0, m2, m1, m0 = quadratics(A, B, C, hp, hq, hr, 1.0)
    return quartic(n2, n1, n0, d1, d0, m2, m1, m0, hr)


@scalar
def quartic_in_ratio(A, B, C, hp, hq, hr):  # type: ignore[no-untyped-def]
    """The quartic by powers of x itself, as in the paper."""
    n2, n1, n0, d1, d0, m2, m1, m0 = quadratics(A, B, C, hp, hq, hr, 1.0)
    return quartic(n2, n1 - 2.0 * n2, n0 - n1 + n2, d1, d0 - d1, m2, m1 - 2.0 * m2, m0 - m1 + m2, hr)


@scalar
def distinct(hab, hbc, hca, hbd, hda):  # type: ignore[no-untyped-def]
    """Whether no two bearings are one: there x = 1 solves every quartic, and agreement says nothing."""
    return min(min(hab, hbc, hca), min(hbd, hda)) > COINCIDENT


@scalar
def matrix_entry(A, B, C, B2, C2, hab, hbc, hca, hbd, hda):  # type: ignore[no-untyped-def]
    """|R_88| of the two quartics in x, as in the paper."""
    p4, p3, p2, p1, p0 = quartic_about_one(A, B, C, hab, hbc, hca)
    q4, q3, q2, q1, q0 = quartic_about_one(A, B2, C2, hab, hbd, hda)
    entry = unit_last_entry_quartic_about_one(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0)
    return entry if distinct(hab, hbc, hca, hbd, hda) else NO_INFORMATION


@scalar
def matrix_entry_both(A, B, C, B2, C2, hab, hbc, hca, hbd, hda):  # type: ignore[no-untyped-def]
    """The lesser |R_88| of the quartics in x and in 1/x."""
    p4, p3, p2, p1, p0 = quartic_about_one(A, B, C, hab, hbc, hca)
    q4, q3, q2, q1, q0 = quartic_about_one(A, B2, C2, hab, hbd, hda)
    entry = lesser_unit_last_entry_quartic_about_one(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0)
    return entry if distinct(hab, hbc, hca, hbd, hda) else NO_INFORMATION


@scalar
def singular_value(A, B, C, B2, C2, hab, hbc, hca, hbd, hda):  # type: ignore[no-untyped-def]
    """Least singular value of the 8×8 Sylvester matrix of the two quartics in x."""
    p4, p3, p2, p1, p0 = quartic_in_ratio(A, B, C, hab, hbc, hca)
    q4, q3, q2, q1, q0 = quartic_in_ratio(A, B2, C2, hab, hbd, hda)
    i = 1.0 / np.sqrt(p4 * p4 + p3 * p3 + p2 * p2 + p1 * p1 + p0 * p0)
    j = 1.0 / np.sqrt(q4 * q4 + q3 * q3 + q2 * q2 + q1 * q1 + q0 * q0)
    return smallest_singular_value_quartic(
        i * p4, i * p3, i * p2, i * p1, i * p0, j * q4, j * q3, j * q2, j * q1, j * q0
    )


SHARED_FIRST = ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2), (2, 3, 0, 1))
"""Orders of a 4-tuple, one for each choice of the two correspondences that both triples share."""


def resultant_kernels(value: Any) -> ResidualKernels:
    """Edge and slab kernels of a residual that compares the quartics alone."""

    @scalar
    def at(t, a, b, c, d, k, l, m, n):  # type: ignore[no-untyped-def]  # noqa: E741
        s = t.distance2
        h = t.versine
        return value(s[a, b], s[b, c], s[a, c], s[b, d], s[a, d], h[k, l], h[l, m], h[k, m], h[l, n], h[k, n])

    @kernel
    def edge(t, kind, i, j):  # type: ignore[no-untyped-def]
        worst = -1.0
        for pair in range(6):
            if kind.pairs >> pair & 1:
                a, b, c, d = SHARED_FIRST[pair]
                worst = max(worst, at(t, i[a], i[b], i[c], i[d], j[a], j[b], j[c], j[d]))
        return worst

    @kernel
    def row(t, kind, i, j, out):  # type: ignore[no-untyped-def]
        s = t.distance2
        h = t.versine
        if kind.pairs == 1:
            A, B, C, B2, C2 = s[i[0], i[1]], s[i[1], i[2]], s[i[0], i[2]], s[i[1], i[3]], s[i[0], i[3]]
            hab, hbc, hca = h[j[0], j[1]], h[j[1], j[2]], h[j[0], j[2]]
            hbd, hda = h[j[1]], h[j[0]]
            for k in range(out.shape[0]):
                out[k] = value(A, B, C, B2, C2, hab, hbc, hca, hbd[k], hda[k])
        else:
            for k in range(out.shape[0]):
                out[k] = edge(t, kind, i, (j[0], j[1], j[2], k))

    return ResidualKernels(edge, slab_of_rows(row))

"""One resultant of a P3P hyper-edge in units of the noise.

At a root z of the quartic p of abc, the quartic q of abd should vanish too. To first order the resultant of both is, up
to a factor, f = q'(z) p(z) − p'(z) q(z), whose variance follows from the partials of the quartics in the five cosines
and from the Gram matrix of the bearings; f over its standard deviation does not depend on scaling or chart. The least
over the roots of p is taken: the resultant is a product over them, and vanishes with any factor.
"""

from __future__ import annotations

import numpy as np

from rootmatch.kernels.dispatch import kernel, register, scalar
from rootmatch.kernels.kinds import Normalised
from rootmatch.kernels.p3p import LARGE, SHARED_FIRST, STEP, P3PTables, distinct, quadratics
from rootmatch.kernels.p3p_roots import ratio_pairs


@scalar
def tangent_gram(hab, hac, hbc):  # type: ignore[no-untyped-def]
    """Product of bearings b and c after both lost their component along bearing a."""
    return hab + hac - hbc - hab * hac


@scalar
def variance_of_three(hx, hy, hz, hxy, hxz, hyz, gx, gy, gz):  # type: ignore[no-untyped-def]
    """|Σ g_k u_k|² across one bearing for its three partners x, y, z, from versines alone."""
    return (
        gx * gx * hx * (2.0 - hx)
        + gy * gy * hy * (2.0 - hy)
        + gz * gz * hz * (2.0 - hz)
        + 2.0
        * (
            gx * gy * tangent_gram(hx, hy, hxy)
            + gx * gz * tangent_gram(hx, hz, hxz)
            + gy * gz * tangent_gram(hy, hz, hyz)
        )
    )


@scalar
def variance_of_two(hx, hy, hxy, gx, gy):  # type: ignore[no-untyped-def]
    """`variance_of_three` of a bearing that meets only two others."""
    return gx * gx * hx * (2.0 - hx) + gy * gy * hy * (2.0 - hy) + 2.0 * gx * gy * tangent_gram(hx, hy, hxy)


@scalar
def value_and_partials(A, B, C, hp, hq, hr, z):  # type: ignore[no-untyped-def]
    """The quartic at z, its derivative in z, and its partials in the three cosines (p, q, r)."""
    n2, n1, n0, d1, d0, m2, m1, m0 = quadratics(A, B, C, hp, hq, hr, STEP)
    x = 1.0 + STEP * z
    r = 1.0 - hr
    N = (n2 * z + n1) * z + n0
    D = d1 * z + d0
    M = (m2 * z + m1) * z + m0
    inner = 2.0 * N - 4.0 * r * D
    mixed = 8.0 * D * M - 4.0 * r * N
    value = N * N - 4.0 * r * N * D + 4.0 * D * D * M
    slope = inner * (2.0 * n2 * z + n1) + mixed * d1 + 4.0 * D * D * (2.0 * m2 * z + m1)
    inverse = 1.0 / A
    by_p = 2.0 * x * inverse * (4.0 * D * D * C - (B - C) * inner)
    return value, slope, by_p, -x * mixed, mixed - 4.0 * N * D


@scalar
def normalised2(p, dp, p_ab, p_bc, p_ca, A, B2, C2, hab, hbc, hca, hbd, hda, hcd, va, vb, vc, vd, z):  # type: ignore[no-untyped-def]
    """Square of one resultant over its variance, at a root z of the first quartic."""
    q, dq, q_ab, q_bd, q_da = value_and_partials(A, B2, C2, hab, hbd, hda, z)
    f = dq * p - dp * q
    g_ab = dq * p_ab - dp * q_ab
    g_bc = dq * p_bc
    g_ca = dq * p_ca
    g_bd = -dp * q_bd
    g_da = -dp * q_da
    variance = va * variance_of_three(hab, hca, hda, hbc, hbd, hcd, g_ab, g_ca, g_da)
    variance += vb * variance_of_three(hab, hbc, hbd, hca, hda, hcd, g_ab, g_bc, g_bd)
    variance += vc * variance_of_two(hca, hbc, hab, g_ca, g_bc)
    variance += vd * variance_of_two(hda, hbd, hab, g_da, g_bd)
    ratio = f * f / variance
    # collinear triples cancel to a variance below 0: no information
    known = (0.0 <= ratio < LARGE * LARGE) and distinct(hab, hbc, hca, hbd, hda)
    return ratio if known else LARGE * LARGE


@kernel
def row_of_pair(t, a, b, c, d, k, l, m, out):  # type: ignore[no-untyped-def]  # noqa: E741
    """Normalised resultants with (a, k), (b, l), (c, m) and d at every target."""
    s = t.distance2
    h = t.versine
    v = t.variance
    A, B, C, B2, C2 = s[a, b], s[b, c], s[a, c], s[b, d], s[a, d]
    hab, hbc, hca = h[k, l], h[l, m], h[k, m]
    va, vb, vc = v[k], v[l], v[m]
    hbd, hda, hcd = h[l], h[k], h[m]
    ratios = ratio_pairs(A, B, C, hab, hbc, hca)
    fresh = True
    for root in range(4):
        x, y = ratios[2 * root], ratios[2 * root + 1]
        if not (x > 0.0 and y > 0.0):
            continue
        z = (x - 1.0) / STEP
        p, dp, p_ab, p_bc, p_ca = value_and_partials(A, B, C, hab, hbc, hca, z)
        for n in range(out.shape[0]):
            r = normalised2(
                p, dp, p_ab, p_bc, p_ca, A, B2, C2, hab, hbc, hca, hbd[n], hda[n], hcd[n], va, vb, vc, v[n], z
            )
            out[n] = r if fresh else min(out[n], r)
        fresh = False
    for n in range(out.shape[0]):
        out[n] = LARGE if fresh else np.sqrt(out[n])


@kernel
def value_of_pair(t, a, b, c, d, k, l, m, n):  # type: ignore[no-untyped-def]  # noqa: E741
    """Normalised resultant of the hyper-edge (a, k), (b, l), (c, m), (d, n), whose triples share the first two."""
    s = t.distance2
    h = t.versine
    v = t.variance
    A, B, C = s[a, b], s[b, c], s[a, c]
    hab, hbc, hca = h[k, l], h[l, m], h[k, m]
    ratios = ratio_pairs(A, B, C, hab, hbc, hca)
    least = LARGE * LARGE
    for root in range(4):
        x, y = ratios[2 * root], ratios[2 * root + 1]
        if x > 0.0 and y > 0.0:
            z = (x - 1.0) / STEP
            p, dp, p_ab, p_bc, p_ca = value_and_partials(A, B, C, hab, hbc, hca, z)
            r = normalised2(
                p, dp, p_ab, p_bc, p_ca, A, s[b, d], s[a, d], hab, hbc, hca, h[l, n], h[k, n], h[m, n],
                v[k], v[l], v[m], v[n], z,
            )  # fmt: skip
            least = min(least, r)
    return np.sqrt(least)


@kernel
def edge_normalised(t, kind, i, j):  # type: ignore[no-untyped-def]
    """Edge kernel of `Normalised`."""
    worst = -1.0
    for pair in range(6):
        if kind.pairs >> pair & 1:
            a, b, c, d = SHARED_FIRST[pair]
            worst = max(worst, value_of_pair(t, i[a], i[b], i[c], i[d], j[a], j[b], j[c], j[d]))
    return worst


@kernel
def slab_normalised(t, kind, i, j, first, scratch, out):  # type: ignore[no-untyped-def]
    """Slab kernel of `Normalised`."""
    for r in range(out.shape[0]):
        i[3] = first + r
        if kind.pairs == 1:
            row_of_pair(t, i[0], i[1], i[2], i[3], j[0], j[1], j[2], out[r])
        else:
            for n in range(out.shape[1]):
                j[3] = n
                out[r, n] = edge_normalised(t, kind, i, j)


register(P3PTables, Normalised, edge_normalised, slab_normalised)

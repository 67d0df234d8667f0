"""One resultant of a P3P hyper-edge in units of the noise.

At a root z of the quartic p of abc, the quartic q of abd should vanish too. To first order the resultant of both is, up
to a factor, f = q'(z) p(z) − p'(z) q(z), whose variance follows from the partials of the quartics in the five cosines
and from the Gram matrix of the bearings; f over its standard deviation does not depend on scaling or chart. The least
over the roots of p is taken: the resultant is a product over them, and vanishes with any factor.
"""

from __future__ import annotations

from math import nan

from rootmatch.jit.decorators import kernel, scalar
from rootmatch.problems.limits import UNINFORMATIVE
from rootmatch.problems.p3p.quartic import STEP, quadratics
from rootmatch.problems.p3p.resultant_residual import COINCIDENT, are_bearings_distinct
from rootmatch.problems.p3p.roots import ratio_pairs, solve_all
from rootmatch.problems.pairs import edge_kernel_of_pairs, root_kernel, slab_kernel_of_edges


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
    known = (0.0 <= ratio < UNINFORMATIVE * UNINFORMATIVE) and are_bearings_distinct(hab, hbc, hca, hbd, hda)
    return ratio if known else UNINFORMATIVE * UNINFORMATIVE


@scalar
def linear_forms(A, B2, C2, hab, x, dp):  # type: ignore[no-untyped-def]
    """What the quartic of abd at x takes from a, b and d before their images are known; see `squared_ratio`."""
    n2, n1, n0, _, _, m2, m1, m0 = quadratics(A, B2, C2, hab, 0.0, 0.0, STEP)
    z = (x - 1.0) / STEP
    inverse = 1.0 / (dp if dp != 0.0 else 1e-300)
    N, M = (n2 * z + n1) * z + n0, 4.0 * ((m2 * z + m1) * z + m0)
    by_ab = 2.0 * x / A
    return (
        N, M, (2.0 * n2 * z + n1) * inverse, STEP * inverse, 4.0 * (2.0 * m2 * z + m1) * inverse,
        4.0 * C2 * by_ab, (B2 - C2) * by_ab,
    )  # fmt: skip


@scalar
def squared_ratio(forms, x, p, p_ab, k1, k2, k3, k4, k5, hbc, hca, hbd, hda, hcd, waa, wbb, wab, tad, tbd):  # type: ignore[no-untyped-def]
    """`normalised2` divided through by p', with all that does not depend on d's image taken out."""
    N, M, inner_slope, mixed_slope, M_slope, c2, bc = forms
    D = x * hbd - hda - (x - 1.0)
    D2 = D * D
    MD = M * D
    K = MD - 4.0 * N * (1.0 - hda)
    mixed = K + MD
    inner = 2.0 * N - 4.0 * (1.0 - hda) * D
    s = inner * inner_slope + mixed * (hbd - 1.0) * mixed_slope + D2 * M_slope
    f = s * p - (N * N + D * K)
    g_ab = s * p_ab - (c2 * D2 - bc * inner)
    g_bd = x * mixed
    g_da = 4.0 * N * D - mixed
    variance = g_ab * (g_ab * k1 + s * k3 + g_da * tad + g_bd * tbd)
    variance += s * (s * k2 + g_da * k4 * (hca + hda - hca * hda - hcd) + g_bd * k5 * (hbc + hbd - hbc * hbd - hcd))
    variance += g_da * (g_da * waa + g_bd * wab) + g_bd * g_bd * wbb
    ratio = f * f / variance
    # collinear triples cancel to a variance below 0: no information
    return ratio if 0.0 <= ratio < UNINFORMATIVE * UNINFORMATIVE else UNINFORMATIVE * UNINFORMATIVE


@kernel
def fill_panel(t, kind, i, j, panel):  # type: ignore[no-untyped-def]
    """Panel kernel of `Normalised`: the roots for every third image, and d's part of the variance for every image.

    Rows 8 to 12: weights of g_da², g_bd², g_da g_bd, g_ab g_da and g_ab g_bd.
    """
    solve_all(t, i, j, panel)
    h = t.versine
    hab, hbd, hda = h[j[0], j[1]], h[j[1]], h[j[0]]
    va, vb, v = t.variance[j[0]], t.variance[j[1]], t.variance
    for n in range(panel.shape[1]):
        apart = min(hbd[n], hda[n]) > COINCIDENT
        panel[8, n] = (va + v[n]) * hda[n] * (2.0 - hda[n]) if apart else nan
        panel[9, n] = (vb + v[n]) * hbd[n] * (2.0 - hbd[n])
        panel[10, n] = 2.0 * v[n] * tangent_gram(hda[n], hbd[n], hab)
        panel[11, n] = 2.0 * va * tangent_gram(hab, hda[n], hbd[n])
        panel[12, n] = 2.0 * vb * tangent_gram(hab, hbd[n], hda[n])


@kernel
def slab_of_pair(t, i, j, first, panel, out):  # type: ignore[no-untyped-def]
    """Squares of the normalised resultants of the triple with every last correspondence."""
    s = t.distance2
    h = t.versine
    v = t.variance
    A, B, C = s[i[0], i[1]], s[i[1], i[2]], s[i[0], i[2]]
    hab, hbc, hca = h[j[0], j[1]], h[j[1], j[2]], h[j[0], j[2]]
    va, vb, vc = v[j[0]], v[j[1]], v[j[2]]
    hbd, hda, hcd = h[j[1]], h[j[0]], h[j[2]]
    waa, wbb, wab, tad, tbd = panel[8], panel[9], panel[10], panel[11], panel[12]
    rows, columns = out.shape
    for r in range(rows):
        for n in range(columns):
            out[r, n] = UNINFORMATIVE * UNINFORMATIVE
    apart = min(min(hab, hbc), hca) > COINCIDENT
    for root in range(4):
        x, y = panel[2 * root, j[2]], panel[2 * root + 1, j[2]]
        if not (x > 0.0 and y > 0.0 and apart):
            continue
        p, dp, p_ab, p_bc, p_ca = value_and_partials(A, B, C, hab, hbc, hca, (x - 1.0) / STEP)
        k1 = (va + vb) * hab * (2.0 - hab)
        k2 = va * p_ca * p_ca * hca * (2.0 - hca) + vb * p_bc * p_bc * hbc * (2.0 - hbc)
        k2 += vc * variance_of_two(hca, hbc, hab, p_ca, p_bc)
        k3 = 2.0 * (va * p_ca * tangent_gram(hab, hca, hbc) + vb * p_bc * tangent_gram(hab, hbc, hca))
        k4, k5 = 2.0 * va * p_ca, 2.0 * vb * p_bc
        for r in range(rows):
            d = first + r
            line = out[r]
            forms = linear_forms(A, s[i[1], d], s[i[0], d], hab, x, dp)
            for n in range(columns):
                ratio = squared_ratio(
                    forms, x, p, p_ab, k1, k2, k3, k4, k5, hbc, hca, hbd[n], hda[n], hcd[n],
                    waa[n], wbb[n], wab[n], tad[n], tbd[n],
                )  # fmt: skip
                line[n] = min(line[n], ratio)


@kernel
def squared_pair_residual(t, i, j, order):  # type: ignore[no-untyped-def]
    """Square of the normalised resultant of a hyper-edge taken in an order; the triples share the first two."""
    s = t.distance2
    h = t.versine
    v = t.variance
    a, b, c, d = i[order[0]], i[order[1]], i[order[2]], i[order[3]]
    k, l, m, n = j[order[0]], j[order[1]], j[order[2]], j[order[3]]  # noqa: E741
    A, B, C = s[a, b], s[b, c], s[a, c]
    hab, hbc, hca = h[k, l], h[l, m], h[k, m]
    ratios = ratio_pairs(A, B, C, hab, hbc, hca)
    minimum = UNINFORMATIVE * UNINFORMATIVE
    for root in range(4):
        x, y = ratios[2 * root], ratios[2 * root + 1]
        if x > 0.0 and y > 0.0:
            z = (x - 1.0) / STEP
            p, dp, p_ab, p_bc, p_ca = value_and_partials(A, B, C, hab, hbc, hca, z)
            r = normalised2(
                p, dp, p_ab, p_bc, p_ca, A, s[b, d], s[a, d], hab, hbc, hca, h[l, n], h[k, n], h[m, n],
                v[k], v[l], v[m], v[n], z,
            )  # fmt: skip
            minimum = min(minimum, r)
    return minimum


squared = edge_kernel_of_pairs(squared_pair_residual, 3)
several = slab_kernel_of_edges(squared)
edge = root_kernel(squared)


@kernel
def slab(t, kind, i, j, first, panel, scratch, out):  # type: ignore[no-untyped-def]
    """Slab kernel of `Normalised`: squares."""
    if kind.pairs == 1:
        slab_of_pair(t, i, j, first, panel, out)
    else:
        several(t, kind, i, j, first, out)

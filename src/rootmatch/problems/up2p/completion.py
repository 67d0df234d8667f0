"""Predictions of the upright two-point problem for many points at once, in loops that fill whole vectors.

The same as `rootmatch.problems.up2p.hypotheses.predictions`, in another form. A point is seen at P = λ a + q with
q = R (X − X₀). Along an axis w across P it moves by λ (w − α k − β l) · ∂a + μ (α k + β l) · ∂b; α = w · a / k · a and
β = (w × q)_y / k · a. With the products of k and l taken once for all, each point costs a few scalar products.
"""

from __future__ import annotations

import numpy as np

from rootmatch.algebra.vector import cross, dot, tangents
from rootmatch.jit.decorators import part
from rootmatch.problems.kernels import STRIDE
from rootmatch.problems.up2p.hypotheses import VAGUE2, depths, response, turns_of
from rootmatch.problems.up2p.resultant import faces


@part
def predict(t, flat, count, j, root, out):  # type: ignore[no-untyped-def]
    """Where points must be seen, and with what covariance; see `CompletionKernels`."""
    u = t.rays
    ax, ay, az = u[0, j[0]], u[1, j[0]], u[2, j[0]]
    bx, by, bz = u[0, j[1]], u[1, j[1]], u[2, j[1]]
    X, Y, Z = flat[0], flat[STRIDE], flat[2 * STRIDE]
    dx, dy, dz = flat[1] - X, flat[STRIDE + 1] - Y, flat[2 * STRIDE + 1] - Z
    c1, s1, c2, s2 = turns_of(dx, dy, dz, ax, ay, az, bx, by, bz)
    c, s = (c1, s1) if root == 0 else (c2, s2)
    first, second, px, _, pz = depths(c, s, dx, dy, dz, ax, ay, az, bx, by, bz)
    if not (first > 0.0 and second > 0.0):
        return False
    nx, ny, nz = 3 * STRIDE, 4 * STRIDE, 5 * STRIDE
    if not (
        faces(c, s, flat[nx], flat[ny], flat[nz], ax, ay, az)
        and faces(c, s, flat[nx + 1], flat[ny + 1], flat[nz + 1], bx, by, bz)
    ):
        return False
    # first and last row of the adjugate of the matrix (a, −b, R'Δ), R'Δ = (p_z, 0, −p_x)
    k = cross(-bx, -by, -bz, pz, 0.0, -px)
    l = cross(ax, ay, az, -bx, -by, -bz)  # noqa: E741
    lx, ly, lz = l
    ka = dot(k[0], k[1], k[2], ax, ay, az)
    inverse = 1.0 / ka
    kk, kl, ll = dot(*k, *k), dot(*k, *l), dot(*l, *l)
    # k across a; it is across b already, and l across both
    kx, ky, kz = k[0] - ka * ax, k[1] - ka * ay, k[2] - ka * az
    of_a, of_b = t.variance[j[0]] * first * first, t.variance[j[1]] * second * second
    qq, qr, rr = of_a * (kk - ka * ka) + of_b * kk, (of_a + of_b) * kl, (of_a + of_b) * ll
    for d in range(count):
        ex, ey, ez = flat[d] - X, flat[STRIDE + d] - Y, flat[2 * STRIDE + d] - Z
        qx, qz = c * ex + s * ez, c * ez - s * ex
        x, y, z = first * ax + qx, first * ay + ey, first * az + qz
        length = 1.0 / np.sqrt(x * x + y * y + z * z)
        x, y, z = x * length, y * length, z * length
        (e0, e1, e2), (f0, f1, f2) = tangents(x, y, z)
        ea, fa = dot(e0, e1, e2, ax, ay, az), dot(f0, f1, f2, ax, ay, az)
        ek, fk = dot(e0, e1, e2, kx, ky, kz), dot(f0, f1, f2, kx, ky, kz)
        el, fl = dot(e0, e1, e2, lx, ly, lz), dot(f0, f1, f2, lx, ly, lz)
        ep, fp = ea * inverse, fa * inverse  # α
        er, fr = (e0 * qz - e2 * qx) * inverse, (f0 * qz - f2 * qx) * inverse  # β
        scale = length * length
        s11 = of_a * (1.0 - ea * ea - 2.0 * (ep * ek + er * el)) + qq * ep * ep + 2.0 * qr * ep * er + rr * er * er
        s22 = of_a * (1.0 - fa * fa - 2.0 * (fp * fk + fr * fl)) + qq * fp * fp + 2.0 * qr * fp * fr + rr * fr * fr
        s12 = qq * ep * fp + qr * (ep * fr + fp * er) + rr * er * fr
        s12 -= of_a * (ea * fa + ep * fk + fp * ek + er * fl + fr * el)
        seen = faces(c, s, flat[nx + d], flat[ny + d], flat[nz + d], x, y, z)
        out[d], out[STRIDE + d], out[2 * STRIDE + d] = x, y, z
        out[3 * STRIDE + d], out[4 * STRIDE + d], out[5 * STRIDE + d] = s11 * scale, s12 * scale, s22 * scale
        out[6 * STRIDE + d] = 1.0 if (s11 + s22) * scale < VAGUE2 and seen else 0.0
    tilt = t.tilt_variance[0]
    if tilt > 0.0:
        for d in range(count):
            x, y, z = out[d], out[STRIDE + d], out[2 * STRIDE + d]
            ex, ey, ez = flat[d] - X, flat[STRIDE + d] - Y, flat[2 * STRIDE + d] - Z
            qx, qz = c * ex + s * ez, c * ez - s * ex
            px, py, pz = first * ax + qx, first * ay + ey, first * az + qz
            length = 1.0 / np.sqrt(px * px + py * py + pz * pz)
            e, f = tangents(x, y, z)
            near, far = first * length, second * length
            _, _, t1x, t1z = response(e, qx, qz, k, l, inverse, near, far, ax, ay, az, bx, by, bz)
            _, _, t2x, t2z = response(f, qx, qz, k, l, inverse, near, far, ax, ay, az, bx, by, bz)
            # the tilt turns what is seen as well
            r1x, _, r1z = cross(x, y, z, *e)
            r2x, _, r2z = cross(x, y, z, *f)
            t1x, t1z, t2x, t2z = t1x - r1x, t1z - r1z, t2x - r2x, t2z - r2z
            s11 = out[3 * STRIDE + d] + tilt * (t1x * t1x + t1z * t1z)
            s22 = out[5 * STRIDE + d] + tilt * (t2x * t2x + t2z * t2z)
            out[4 * STRIDE + d] += tilt * (t1x * t2x + t1z * t2z)
            out[3 * STRIDE + d], out[5 * STRIDE + d] = s11, s22
            if not s11 + s22 < VAGUE2:
                out[6 * STRIDE + d] = 0.0
    return True

"""The Sylvester matrix of two polynomials, and its least singular value without a linear algebra library.

`sylvester_matrix` is the plain construction of the paper's equation 3, for NumPy. The scalar functions hold the matrix
as rows of plain floats: no array, so they run wherever the other kernels do, on a GPU too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.jit.decorators import kernel, scalar

SWEEPS = 30
"""Bound on the sweeps of Jacobi rotations; 5 to 9 are usual. Not tuned."""
ORTHOGONAL = 1e-30
"""Rows are orthogonal when the square of the cosine between them is below this: rounding, 1e-15."""
NOTHING = 1e-68
"""Or when the square of their product is below this times the fourth power of the matrix's size: nothing is left."""


def sylvester_matrix(p: ArrayLike, q: ArrayLike) -> NDArray[np.float64]:
    """Sylvester matrices (…, 2k, 2k) of polynomials (…, k + 1) of the same degree k, highest degree first.

    Rows 0 … k − 1 hold p, shifted by one column more in each, rows k … 2k − 1 likewise q. At a common root x the vector
    (x^{2k−1}, …, x, 1) is in the null space. The paper scales p and q to unit 2-norm first; that is left to the caller.
    """
    first, second = np.broadcast_arrays(np.asarray(p, dtype=float), np.asarray(q, dtype=float))
    degree = first.shape[-1] - 1
    matrix = np.zeros((*first.shape[:-1], 2 * degree, 2 * degree))
    for row in range(degree):
        matrix[..., row, row : row + degree + 1] = first
        matrix[..., degree + row, row : row + degree + 1] = second
    return matrix


@scalar
def dot4(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of two 4-tuples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@scalar
def mixed4(c, a, s, b):  # type: ignore[no-untyped-def]
    """Sum c a + s b of two 4-tuples."""
    return c * a[0] + s * b[0], c * a[1] + s * b[1], c * a[2] + s * b[2], c * a[3] + s * b[3]


@scalar
def rotation(aa, bb, ab, nothing):  # type: ignore[no-untyped-def]
    """Cosine and sine of the rotation that makes two rows orthogonal, and whether they were not orthogonal before."""
    rotates = ab * ab > ORTHOGONAL * aa * bb + nothing
    tau = (bb - aa) / (2.0 * ab if rotates else 1.0)
    tangent = 1.0 / (abs(tau) + math.sqrt(1.0 + tau * tau))
    tangent = tangent if tau >= 0.0 else -tangent
    tangent = tangent if rotates else 0.0
    cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
    return cosine, cosine * tangent, rotates


@scalar
def jacobi_rotate4(a, b, nothing):  # type: ignore[no-untyped-def]
    """Two rows of 4 made orthogonal by a Jacobi rotation, and whether they were not orthogonal before."""
    c, s, rotates = rotation(dot4(a, a), dot4(b, b), dot4(a, b), nothing)
    return mixed4(c, a, -s, b), mixed4(s, a, c, b), rotates


@scalar
def square8(a):  # type: ignore[no-untyped-def]
    """Squared length of a row of 8."""
    return dot4(a[0], a[0]) + dot4(a[1], a[1])


@scalar
def jacobi_rotate8(a, b, nothing):  # type: ignore[no-untyped-def]
    """Two rows of 8 (pairs of 4-tuples) made orthogonal by a Jacobi rotation, and whether they were not before."""
    c, s, rotates = rotation(square8(a), square8(b), dot4(a[0], b[0]) + dot4(a[1], b[1]), nothing)
    return (
        (mixed4(c, a[0], -s, b[0]), mixed4(c, a[1], -s, b[1])),
        (mixed4(s, a[0], c, b[0]), mixed4(s, a[1], c, b[1])),
        rotates,
    )


@kernel
def smallest_singular_value_quartic(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0):  # type: ignore[no-untyped-def]
    """Least singular value of the 8×8 Sylvester matrix of two quartics as given.

    One-sided Jacobi (Hestenes): rotate pairs of rows until all are orthogonal; their lengths are the singular values.
    Four pairs at a time, then the rows change places as in a round robin, so that seven rounds meet every pair.

    Notes
    -----
    The difference to ``numpy.linalg.svd`` is below 2e-15 of the largest singular value (measured on random, clustered
    and nearly dependent pairs): a value below that is rounding in either.
    """
    a = ((p4, p3, p2, p1), (p0, 0.0, 0.0, 0.0))
    b = ((0.0, p4, p3, p2), (p1, p0, 0.0, 0.0))
    c = ((0.0, 0.0, p4, p3), (p2, p1, p0, 0.0))
    d = ((0.0, 0.0, 0.0, p4), (p3, p2, p1, p0))
    e = ((q4, q3, q2, q1), (q0, 0.0, 0.0, 0.0))
    f = ((0.0, q4, q3, q2), (q1, q0, 0.0, 0.0))
    g = ((0.0, 0.0, q4, q3), (q2, q1, q0, 0.0))
    h = ((0.0, 0.0, 0.0, q4), (q3, q2, q1, q0))
    size = square8(a) + square8(e)
    nothing = NOTHING * size * size
    quiet = 0
    for _ in range(7 * SWEEPS):
        a, b, turn0 = jacobi_rotate8(a, b, nothing)
        c, d, turn1 = jacobi_rotate8(c, d, nothing)
        e, f, turn2 = jacobi_rotate8(e, f, nothing)
        g, h, turn3 = jacobi_rotate8(g, h, nothing)
        b, c, e, g, h, f, d = d, b, c, e, g, h, f
        quiet = 0 if turn0 or turn1 or turn2 or turn3 else quiet + 1
        if quiet == 7:
            break
    return math.sqrt(
        min(
            min(min(square8(a), square8(b)), min(square8(c), square8(d))),
            min(min(square8(e), square8(f)), min(square8(g), square8(h))),
        )
    )


@kernel
def smallest_singular_value_quadratic(p2, p1, p0, q2, q1, q0):  # type: ignore[no-untyped-def]
    """Least singular value of the 4×4 Sylvester matrix of two quadratics; see `smallest_singular_value_quartic`."""
    a = (p2, p1, p0, 0.0)
    b = (0.0, p2, p1, p0)
    c = (q2, q1, q0, 0.0)
    d = (0.0, q2, q1, q0)
    size = dot4(a, a) + dot4(c, c)
    nothing = NOTHING * size * size
    quiet = 0
    for _ in range(3 * SWEEPS):
        a, b, turn0 = jacobi_rotate4(a, b, nothing)
        c, d, turn1 = jacobi_rotate4(c, d, nothing)
        b, c, d = d, b, c
        quiet = 0 if turn0 or turn1 else quiet + 1
        if quiet == 3:
            break
    return math.sqrt(min(min(dot4(a, a), dot4(b, b)), min(dot4(c, c), dot4(d, d))))

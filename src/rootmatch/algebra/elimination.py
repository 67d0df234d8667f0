"""Linear equations with a symmetric positive definite matrix, compiled: by elimination, or by a Cholesky factor."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import kernel, part


@kernel
def solve_in_place(matrix, side, dimensions):  # type: ignore[no-untyped-def]
    """A symmetric positive system, solved into ``side`` by elimination; the matrix is overwritten."""
    for a in range(dimensions):
        pivot = 1.0 / matrix[a, a]
        for b in range(a + 1, dimensions):
            f = matrix[b, a] * pivot
            for d in range(a, dimensions):
                matrix[b, d] -= f * matrix[a, d]
            side[b] -= f * side[a]
    for back in range(dimensions):
        a = dimensions - 1 - back
        total = side[a]
        for b in range(a + 1, dimensions):
            total -= matrix[a, b] * side[b]
        side[a] = total / matrix[a, a]


@part
def solve_damped(normal, side, damping, dimensions, work, out):  # type: ignore[no-untyped-def]
    """The damped symmetric system, by elimination; whether it has a finite solution."""
    for a in range(dimensions):
        for b in range(dimensions):
            work[a, b] = normal[a, b]
        work[a, a] = work[a, a] * (1.0 + damping) + 1e-300
        out[a] = side[a]
    solve_in_place(work, out, dimensions)
    finite = True
    for a in range(dimensions):
        finite = finite and abs(out[a]) < 1e6
    return finite


@part
def factorise(matrix, size, minimum):  # type: ignore[no-untyped-def]
    """The Cholesky factor of the first rows of a matrix, in the place of its lower triangle.

    ``minimum``: of the squares of its diagonal, where rounding leaves less.
    """
    for i in range(size):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(value, minimum)) if i == j else value / matrix[j, j]


@part
def solve_lower(factor, size, side):  # type: ignore[no-untyped-def]
    """L⁻¹ times a vector, in place; its square."""
    squared = 0.0
    for i in range(size):
        value = side[i]
        for k in range(i):
            value -= factor[i, k] * side[k]
        side[i] = value / factor[i, i]
        squared += side[i] * side[i]
    return squared


@part
def invert_factored(factor, size, out):  # type: ignore[no-untyped-def]
    """The inverse (size, size) of a matrix by its factor, into ``out``."""
    for column in range(size):
        for i in range(size):
            value = 1.0 if i == column else 0.0
            for k in range(i):
                value -= factor[i, k] * out[k, column]
            out[i, column] = value / factor[i, i]
        for i in range(size - 1, -1, -1):
            value = out[i, column]
            for k in range(i + 1, size):
                value -= factor[k, i] * out[k, column]
            out[i, column] = value / factor[i, i]

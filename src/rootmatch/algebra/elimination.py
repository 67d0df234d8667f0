"""Linear equations solved by elimination, compiled."""

from __future__ import annotations

from rootmatch.jit.decorators import kernel


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

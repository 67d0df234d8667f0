"""Eigenvectors of small symmetric matrices, compiled."""

from __future__ import annotations

import math

from rootmatch.jit.decorators import part

SWEEPS = 10
"""Most rounds of rotations in which a symmetric matrix becomes diagonal: each squares what is left beside it."""
NOTHING = 1e-34
"""Square of what is left beside two numbers of the diagonal, over their product, up to which it is left."""


@part
def diagonalise(matrix, axes):  # type: ignore[no-untyped-def]
    """Make a symmetric matrix (p, p) diagonal by Jacobi's rotations; ``axes`` (p, p): its eigenvectors as columns."""
    size = matrix.shape[0]
    for i in range(size):
        for j in range(size):
            axes[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        turned = False
        for p in range(size - 1):
            for q in range(p + 1, size):
                beside = matrix[p, q]
                if beside * beside <= NOTHING * abs(matrix[p, p] * matrix[q, q]):
                    continue
                turned = True
                half = 0.5 * (matrix[q, q] - matrix[p, p])
                tangent = beside / (half + math.copysign(math.sqrt(half * half + beside * beside), half))
                c = 1.0 / math.sqrt(1.0 + tangent * tangent)
                s = tangent * c
                for i in range(size):
                    first, second = matrix[i, p], matrix[i, q]
                    matrix[i, p], matrix[i, q] = c * first - s * second, s * first + c * second
                for i in range(size):
                    first, second = matrix[p, i], matrix[q, i]
                    matrix[p, i], matrix[q, i] = c * first - s * second, s * first + c * second
                    first, second = axes[i, p], axes[i, q]
                    axes[i, p], axes[i, q] = c * first - s * second, s * first + c * second
                matrix[p, q] = matrix[q, p] = 0.0
        if not turned:
            break

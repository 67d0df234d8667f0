"""3P1 by x = cos θ, as Naroditsky et al. (2012) and the paper write it.

The determinant of a triple is D(θ) = A(cos θ) + sin θ B(cos θ), A of degree 2 and B of degree 1. Its zeros are among
the roots of the quartic A² − (1 − x²) B², which θ and −θ share: the quartic cannot tell the direction of a turn. A and
B follow from the coefficients of h = (1 + tan²(θ/2))² D, so both unknowns read the same determinant.

Only the residuals of two polynomials depend on their unknown. Those in units of the noise go by the roots and are the
same for both.
"""

from __future__ import annotations

from typing import Any

from rootmatch.jit.decorators import scalar
from rootmatch.problems.kernels import ProblemKernels
from rootmatch.problems.pairs import comparisons
from rootmatch.problems.three_plus_one import tables
from rootmatch.problems.three_plus_one.resultant_residual import resultant_kernels


@scalar
def cosine_coefficients(h4, h3, h2, h1, h0):  # type: ignore[no-untyped-def]
    """Coefficients in cos θ, highest degree first, from those of h in tan(θ/2)."""
    # A = a2 x² + a1 x + a0 and B = b1 x + b0 from D(0) = h0, D(180°) = h4, D(±90°) = (h4 + h2 + h0 ± (h3 + h1)) / 4
    # and dD/dθ(0) = h1 / 2.
    a0 = 0.25 * (h4 + h2 + h0)
    a1 = 0.5 * (h0 - h4)
    a2 = 0.5 * (h0 + h4) - a0
    b0 = 0.25 * (h3 + h1)
    b1 = 0.5 * h1 - b0
    return (
        a2 * a2 + b1 * b1,
        2.0 * (a2 * a1 + b1 * b0),
        a1 * a1 + 2.0 * a2 * a0 + b0 * b0 - b1 * b1,
        2.0 * (a1 * a0 - b1 * b0),
        a0 * a0 - b0 * b0,
    )


def _residual_of_cosines(value: Any) -> Any:
    """A residual of two quartics in tan(θ/2) that compares their forms in cos θ."""

    @scalar
    def compared(h4, h3, h2, h1, h0, f4, f3, f2, f1, f0):  # type: ignore[no-untyped-def]
        p4, p3, p2, p1, p0 = cosine_coefficients(h4, h3, h2, h1, h0)
        q4, q3, q2, q1, q0 = cosine_coefficients(f4, f3, f2, f1, f0)
        return value(p4, p3, p2, p1, p0, q4, q3, q2, q1, q0)

    return compared


KERNELS = ProblemKernels(
    residuals={
        **tables.KERNELS.residuals,
        **{kind: resultant_kernels(_residual_of_cosines(compare)) for kind, compare in comparisons(4).items()},
    },
    target_fields=tables.KERNELS.target_fields,
)


class CosineTables(tables.ThreePlusOneTables):
    """Tables of 3P1 whose type selects the kernels in cos θ."""

    __slots__ = ()

    @staticmethod
    def kernels() -> ProblemKernels:
        """The record of the problem's kernels."""
        return KERNELS

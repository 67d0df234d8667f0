"""What the kernels of similarity and congruence read of the two point sets, and the record of those kernels."""

from __future__ import annotations

from typing import NamedTuple

from rootmatch.arrays import Floats
from rootmatch.problems.kernels import ProblemKernels
from rootmatch.problems.pairs import comparisons
from rootmatch.problems.residual_kinds import Joint, Normalised
from rootmatch.problems.similarity.residuals import joint_chi2, normalised_squared, resultant_kernels, triangle_kernels

KERNELS = ProblemKernels(
    residuals={
        **{kind: resultant_kernels(compare) for kind, compare in comparisons(1).items()},
        Normalised: triangle_kernels(normalised_squared),
        Joint: triangle_kernels(joint_chi2),
    },
)


class SimilarityTables(NamedTuple):
    """What the kernels read of the two point sets."""

    source: Floats
    """(n, n) distances."""
    target: Floats
    """(n', n') distances."""
    source_variance: Floats
    """(n,) variance of a coordinate."""
    target_variance: Floats
    """(n',) variance of a coordinate."""
    source_points: Floats
    """(2, n) points of a plane whose orientation counts; zeros otherwise."""
    target_points: Floats
    """(2, n') points of that plane in the other set; zeros otherwise."""
    scale: Floats
    """(1,) target units of one source unit; 0 where it is unknown."""

    @staticmethod
    def kernels() -> ProblemKernels:
        """The record of the problem's kernels."""
        return KERNELS

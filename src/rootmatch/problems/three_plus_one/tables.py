"""What the kernels of 3P1 read of the two images, and the record of those kernels."""

from __future__ import annotations

from typing import NamedTuple

from rootmatch.arrays import Floats
from rootmatch.problems.kernels import ProblemKernels, ResidualKernels
from rootmatch.problems.pairs import comparisons
from rootmatch.problems.residual_kinds import Joint, Normalised
from rootmatch.problems.three_plus_one import normalised_residual
from rootmatch.problems.three_plus_one.resultant_residual import resultant_kernels

KERNELS = ProblemKernels(
    residuals={
        **{kind: resultant_kernels(compare) for kind, compare in comparisons(4).items()},
        # one constraint: both are the same
        Normalised: ResidualKernels(normalised_residual.edge, normalised_residual.slab),
        Joint: ResidualKernels(normalised_residual.edge, normalised_residual.slab),
    },
    target_fields=("target", "target_deviation"),
)


class ThreePlusOneTables(NamedTuple):
    """What the kernels read of the two images, each rotated so that the axis is y."""

    source: Floats
    """(3, n) unit bearings of the first image."""
    target: Floats
    """(3, n') unit bearings of the second image."""
    source_deviation: Floats
    """(n,) standard deviation of a bearing, radians on each axis across it."""
    target_deviation: Floats
    """(n',) standard deviation of a bearing, radians on each axis across it."""
    tilt_variance: Floats
    """(1,) variance of the axis of one view against that of the other, radians² on each of two directions."""

    @staticmethod
    def kernels() -> ProblemKernels:
        """The record of the problem's kernels."""
        return KERNELS

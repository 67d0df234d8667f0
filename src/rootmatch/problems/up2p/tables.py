"""What the kernels of up2p read of the two point sets, and the record of those kernels."""

from __future__ import annotations

from typing import NamedTuple

from rootmatch.arrays import Floats
from rootmatch.problems.kernels import CompletionKernels, HypothesisKernels, ProblemKernels, ResidualKernels
from rootmatch.problems.pairs import comparisons
from rootmatch.problems.residual_kinds import Joint, Normalised
from rootmatch.problems.up2p import hypotheses, joint_residual, normalised_residual
from rootmatch.problems.up2p.resultant_residual import resultant_kernels

KERNELS = ProblemKernels(
    residuals={
        **{kind: resultant_kernels(compare) for kind, compare in comparisons(2).items()},
        Normalised: ResidualKernels(normalised_residual.edge, normalised_residual.slab, squares=True, single=True),
        Joint: ResidualKernels(joint_residual.edge, joint_residual.slab, squares=True, single=True),
    },
    hypotheses=HypothesisKernels(
        coordinates=hypotheses.coordinates,
        solve=hypotheses.solve,
        known=hypotheses.known,
        frame=hypotheses.hypothesis,
        predict=hypotheses.predictions,
        solutions=2,
    ),
    completion=CompletionKernels(solutions=2, fields=("points", "normals"), predict=hypotheses.complete),
    target_fields=("rays", "variance"),
)


class UP2PTables(NamedTuple):
    """What the kernels read of the two point sets, both rotated so that down is +y."""

    points: Floats
    """(3, n) source points in units of their spread."""
    rays: Floats
    """(3, n') unit bearings."""
    variance: Floats
    """(n',) variance of a bearing, radians² on each axis across it."""
    tilt_variance: Floats
    """(1,) variance of the vertical, radians² on each of its two axes."""
    normals: Floats
    """(4, n) outward unit normals of the source points, zero for none, and the least cosine between a normal and the
    direction to the camera at which the point is visible."""

    @staticmethod
    def kernels() -> ProblemKernels:
        """The record of the problem's kernels."""
        return KERNELS

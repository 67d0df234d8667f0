"""What the kernels of P3P read of the two point sets, and the record of those kernels."""

from __future__ import annotations

from typing import NamedTuple

from rootmatch.arrays import Floats
from rootmatch.problems.kernels import HypothesisKernels, ListedKernels, ProblemKernels, ResidualKernels
from rootmatch.problems.p3p import (
    hypotheses,
    joint_residual,
    joint_residual_lists,
    normalised_residual,
    resultant_residual,
)
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth

KERNELS = ProblemKernels(
    residuals={
        QR: resultant_residual.resultant_kernels(resultant_residual.last_entry),
        QRBoth: resultant_residual.resultant_kernels(resultant_residual.lesser_last_entry),
        SVD: resultant_residual.resultant_kernels(resultant_residual.singular_value),
        Normalised: ResidualKernels(
            normalised_residual.edge,
            normalised_residual.slab,
            panel=normalised_residual.fill_panel,
            squares=True,
            single=True,
        ),
        Joint: ResidualKernels(
            joint_residual.edge,
            joint_residual.slab,
            panel=joint_residual.fill_panel,
            fill=joint_residual_lists.fill_block,
            listed=joint_residual_lists.listed,
            squares=True,
            single=True,
        ),
    },
    hypotheses=HypothesisKernels(
        coordinates=hypotheses.coordinates,
        solve=hypotheses.solve,
        known=hypotheses.known,
        frame=hypotheses.hypothesis,
        predict=hypotheses.predictions,
        listed=ListedKernels(
            gather=hypotheses.gather, solve=hypotheses.solve_gathered, frame=hypotheses.gathered_frame
        ),
    ),
    target_fields=("rays", "versine", "variance"),
    source_fields=("distance2", "points", "normals"),
)


class P3PTables(NamedTuple):
    """What the kernels read of the two point sets."""

    distance2: Floats
    """(n, n) squared distances of source points, in units of the mean squared distance."""
    points: Floats
    """(3, n) source points in the same units."""
    versine: Floats
    """(n', n') 1 − cos of the angle between two bearings."""
    rays: Floats
    """(3, n') unit bearings."""
    variance: Floats
    """(n',) variance of a bearing, radians² on each axis across it."""
    normals: Floats
    """(4, n) outward unit normals of the source points, zero for none, and the least cosine between a normal and the
    direction to the camera at which the point is visible."""

    @staticmethod
    def kernels() -> ProblemKernels:
        """The record of the problem's kernels."""
        return KERNELS

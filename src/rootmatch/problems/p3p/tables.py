"""What the kernels of P3P read of the two point sets, and the record of those kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rootmatch.problems.kernels import HypothesisKernels, ProblemKernels, ResidualKernels
from rootmatch.problems.p3p import hypotheses, joint, joint_lists, normalised, resultant
from rootmatch.problems.residual_kinds import QR, SVD, Joint, Normalised, QRBoth

KERNELS = ProblemKernels(
    residuals={
        QR: resultant.resultant_kernels(resultant.matrix_entry),
        QRBoth: resultant.resultant_kernels(resultant.matrix_entry_both),
        SVD: resultant.resultant_kernels(resultant.singular_value),
        Normalised: ResidualKernels(
            normalised.edge_normalised,
            normalised.slab_normalised,
            panel=normalised.panel_normalised,
            squares=True,
            single=True,
        ),
        Joint: ResidualKernels(
            joint.edge_joint,
            joint.slab_joint,
            panel=joint.panel_joint,
            fill=joint_lists.block_joint,
            listed=joint_lists.listed_joint,
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
    ),
    target_fields=("rays", "versine", "variance"),
)


class P3PTables(NamedTuple):
    """What the kernels read of the two point sets."""

    distance2: NDArray[np.float64]
    """(n, n) squared distances of source points, in units of the mean squared distance."""
    points: NDArray[np.float64]
    """(3, n) source points in the same units."""
    versine: NDArray[np.float64]
    """(n', n') 1 − cos of the angle between two bearings."""
    rays: NDArray[np.float64]
    """(3, n') unit bearings."""
    variance: NDArray[np.float64]
    """(n',) variance of a bearing, radians² on each axis across it."""
    normals: NDArray[np.float64]
    """(3, n) outward normals of the source points: a point is seen only from its front. Zero where there is none."""

    @staticmethod
    def kernels() -> ProblemKernels:
        """The record of the problem's kernels."""
        return KERNELS

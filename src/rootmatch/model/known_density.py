"""What is known of a pose in part, as a density: a factor on the broad prior for each thing that is known.

A measurement of σ turns a broad density b(x) into b(x) N(z; x, σ) / ∫ b(x') N(z; x', σ) dx'. If it is precise, that is
a normal distribution about what was measured; the vaguer it is, the less it differs from b, so that it never says more
than is known. The integral is that with a normal distribution of the same volume as b about the measured value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rootmatch.algebra.rotation import rotation_from_vector
from rootmatch.arrays import Floats
from rootmatch.frozen import once
from rootmatch.model.pose_density import (
    ANY_TURN,
    EXACT,
    FIELD,
    NO_PREDICTIONS,
    ROTATIONS,
    TURNS,
    Broad,
    Mixed,
    Mixture,
)
from rootmatch.model.priors import DEPTHS
from rootmatch.problems.pose_fit.pose import Pose
from rootmatch.problems.pose_fit.pose_prior import PosePrior
from rootmatch.problems.pose_fit.reference_point import pose_about_point

MIN_SPREAD = 1e-4
"""Least standard deviation, in radians, of a vertical in a density over poses; in a combination of measurements it is
`rootmatch.problems.pose_fit.pose_prior.MIN_TILT`."""


@dataclass(frozen=True, eq=False)
class Known(Mixed):
    """A rotation, a vertical or a position of the body's origin that is known, with a normal error; broad in the rest.

    Parameters
    ----------
    prior : PosePrior
    centre : (3,) array
        Of the body, in its frame.
    radius : float
        As of `Broad`.
    """

    prior: PosePrior
    centre: Floats
    radius: float = 0.0

    @once
    def for_kernels(self) -> Mixture:
        """See `rootmatch.model.pose_density.PoseDensity.for_kernels`."""
        vector, matrix = np.zeros((1, 3)), np.zeros((1, 3, 3))
        turn, down, place = self.prior.turn, self.prior.down, self.prior.place
        rotations, directions, places = (matrix, matrix), (vector, vector, np.zeros(1)), (vector, matrix, vector)
        log_density = -math.log(ROTATIONS)
        if turn is not None:
            precision, log_gain = _precision_and_gain(turn[1], EXACT, 1.0 / ANY_TURN)
            rotations, log_density = (turn[0][None], precision), log_density + log_gain
        elif down is not None:
            concentration = 1.0 / max(down[2], MIN_SPREAD) ** 2
            directions = down[0][None], down[1][None], np.array([concentration])
            # the density of directions about one is that of von Mises and Fisher
            sphere = -2.0 * math.pi * math.expm1(-2.0 * concentration)
            log_density = math.log(concentration / (sphere * TURNS))
        if place is not None:
            t, size2 = place[0], float(self.centre @ self.centre)
            reach2 = float(t @ t) + size2 if turn is None else float(np.sum((t + turn[0] @ self.centre) ** 2))
            reach2 += self.radius**2
            volume2 = (FIELD * math.log(DEPTHS)) ** (2.0 / 3.0) * reach2 / (2.0 * math.pi)
            precision, log_gain = _precision_and_gain(place[1], EXACT * math.sqrt(reach2), volume2)
            places, log_density = (t[None], precision, self.centre[None]), log_density + log_gain
        known = rotations, directions, places, np.array([log_density])
        return NO_PREDICTIONS, Broad(self.radius).weigh_share(-math.inf), known

    def about(self, pose: Pose) -> Pose:
        """The normal distribution that it is about a pose, to first order; very wide in what is not known."""
        position = pose.t + pose.R @ self.centre
        terms = self.terms(pose.R[None], position[None])
        scale = np.sqrt(np.diag(terms.precision[0]))
        covariance = np.linalg.inv(terms.precision[0] / np.outer(scale, scale)) / np.outer(scale, scale)
        step = covariance @ terms.slope[0]
        R = rotation_from_vector(step[None, :3])[0] @ pose.R
        return Pose.unchecked(R, *pose_about_point(R, position + step[3:], covariance, -self.centre))


def _precision_and_gain(covariance: Floats, minimum: float, broad: float) -> tuple[Floats, float]:
    """Precision (1, 3, 3) of a measurement no more precise than ``minimum``, and what it adds to a log density there.

    ``broad``: variance of the density without it.
    """
    whole = covariance + max(minimum, 1e-150) ** 2 * np.eye(3)
    values = np.linalg.eigvalsh(whole)
    return np.asarray(np.linalg.inv(whole)[None], np.float64), 0.5 * float(np.log1p(broad / values).sum())

"""Whether what is followed is the body: something else of nearly its shape betrays itself by how it fits.

A prediction counts for whatever is there, the body, its reflection, or another model of a controller: each of them is
found where it was expected. What tells them apart is how well the detections fit the body. The chance of residuals as
large is uniform for the body, but for frames that nothing explains, and has a Beta distribution towards 0 for anything
else (compare Sellke, Bayarri and Berger 2001). The odds are those of a test of both, frame by frame, and never below
the first ones: the body may have been exchanged since (Page 1954).
"""

from __future__ import annotations

import math

from rootmatch.explain.goodness_of_fit import Misfit
from rootmatch.model.priors import NOISE_FREEDOM, WRONG_MODEL

SHAPE = 0.2
"""Of the distribution Beta(a, 1) of the chance of residuals as large as those of something else. A round value."""
FREEDOM_OF_RIG = 5.0
"""Residuals by which σ is known about a pose before a rig, whose calibration may be off by more in one place than in
another. A round value."""
FLOOR = math.log(WRONG_MODEL)
"""Log-odds at first, and the least: those of a wrong model."""
GIVEN_UP = math.log(9.0)
"""Log-odds from which a pose is no longer followed. A round value."""


def after_frame(log_odds: float, misfit: Misfit, weight: float, of_rig: bool = False) -> float:
    """Log-odds, after a frame, that what is followed is something else.

    Parameters
    ----------
    log_odds : float
        Before it.
    misfit : Misfit
        Of the detections about the pose.
    weight : float
        Of a frame's evidence, as what spoils one fit may spoil the next.
    of_rig : bool
        Whether the frame is of several cameras.
    """
    from scipy.special import fdtrc  # slow to import

    if not misfit.dof:
        return log_odds
    chance = max(float(fdtrc(misfit.dof, FREEDOM_OF_RIG if of_rig else NOISE_FREEDOM, misfit.sigma**2)), 1e-300)
    other = SHAPE * chance ** (SHAPE - 1.0)
    return max(log_odds + weight * math.log(other / (1.0 - WRONG_MODEL + WRONG_MODEL * other)), FLOOR)

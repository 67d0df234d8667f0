"""The evidence of an assignment with another covariance of its detections, to first order about a pose."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.model.evidence import Evidence


class Reweighed(NamedTuple):
    """An assignment's best pose, to first order, in units of the covariance of its m detections."""

    root: Floats
    """Lower triangular root (2 m, 2 m) of that covariance, px."""
    rows: Floats
    """Jacobian (2 m, 6)."""
    residuals: Floats
    """(2 m,), after the step to the best pose."""
    step: Floats
    """To that, (6,)."""
    covariance: Floats
    """Of that pose, (6, 6)."""
    gained: float
    """Logarithm of its evidence, over that with the covariance before."""


def reweigh_evidence(
    found: Evidence, known: tuple[Floats, Floats, Floats, float], spread: Floats, offset: Floats
) -> Reweighed:
    """The first of some hypotheses with another covariance (2 m, 2 m) and other offsets (2 m,) of its detections.

    ``known``: of what ``found`` is the evidence. Jacobian (2 m, 6) and offsets (2 m,) of the m detections from their
    images, in px, the covariance (2 m, 2 m), and `DetectionModel.noise_freedom`.
    """
    rows, before, alone, given = known
    freedom, squared = float(found.freedom[0]), float(found.squared[0])
    root, apart = np.linalg.cholesky(spread), np.linalg.cholesky(alone)
    (rows, offset), (other_rows, other_offset) = (
        (np.linalg.solve(one, rows), np.linalg.solve(one, of)) for one, of in ((root, offset), (apart, before))
    )
    # what is not of the detections is of the prior
    whole = np.linalg.inv(found.covariance[0])
    precision = rows.T @ rows + whole - other_rows.T @ other_rows
    slope = rows.T @ offset + whole @ found.step[0] - other_rows.T @ other_offset
    covariance = np.linalg.inv(precision)
    step = covariance @ slope
    now = squared + float(found.decrement[0] + offset @ offset - other_offset @ other_offset)
    now = max(now - float(slope @ step), 0.0)
    gained = float(np.log(np.diagonal(apart)).sum() - np.log(np.diagonal(root)).sum())
    gained += 0.5 * float(np.linalg.slogdet(whole)[1] - np.linalg.slogdet(precision)[1])
    gained += 0.5 * (given + freedom) * math.log((given + squared) / (given + now))
    return Reweighed(
        np.asarray(root), rows, residuals=offset - rows @ step, step=step, covariance=covariance, gained=gained
    )

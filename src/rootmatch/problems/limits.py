"""Where a residual or a prediction says nothing: the limits that all problems share."""

from __future__ import annotations

UNINFORMATIVE = 1e6
"""The residual of a hyper-edge that says nothing: no information is not agreement. Far beyond any gate; not tuned."""
VAGUE2 = 1e-2
"""Variance, in radians², beyond which a prediction says nothing. Not tuned: 0.1 rad is a round value, at which the
linearised covariance means little any more."""

"""The limits that all problems share: where nothing agrees any more, and where nothing is said."""

from __future__ import annotations

GATE = 3.5
"""Residual in units of the noise beyond which nothing agrees: with two degrees of freedom 0.2 % of the true hyper-edges
are lost. A round value; the one gate of tensors, hypotheses and groups."""
UNINFORMATIVE = 1e6
"""The residual of a hyper-edge that says nothing: no information is not agreement. Far beyond any gate; not tuned."""
VAGUE2 = 1e-2
"""Variance, in radians², beyond which a prediction says nothing. Not tuned: 0.1 rad is a round value, at which the
linearised covariance means little any more."""
MAX_PAIRS = 6
"""Most pairs of minimal sets that can be chosen: those of a hyper-edge of four."""

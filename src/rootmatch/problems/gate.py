"""The gate: the residual, in units of the noise, beyond which a hyper-edge is dropped."""

from __future__ import annotations

GATE = 3.5
"""Residual in units of the noise beyond which nothing agrees: with two degrees of freedom 0.2 % of the true hyper-edges
are lost. A round value; the one gate of tensors, hypotheses and groups."""

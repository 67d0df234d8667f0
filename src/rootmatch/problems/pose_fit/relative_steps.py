"""Numbers that the fits of a relative pose share, compiled or not."""

from __future__ import annotations

ALONG = 2.0
"""Noise of a position along the line over that across it, as the rotation's own noise adds to it. Not tuned."""
DELTA = 1e-6
"""Step of numerical derivatives, in radians: far above rounding, far below any noise. Not tuned."""

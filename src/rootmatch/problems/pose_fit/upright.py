"""A known vertical, as the fits of camera poses take it."""

from __future__ import annotations

from dataclasses import dataclass

from rootmatch.problems.pose_fit.base import Floats


@dataclass(frozen=True, eq=False)
class Upright:
    """A camera whose vertical is known: rotations of world and camera onto y, and the vertical's σ in radians."""

    world: Floats
    camera: Floats
    noise: float

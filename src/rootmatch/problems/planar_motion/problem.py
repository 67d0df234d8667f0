"""Planar motion: two images from a camera that moves in a plane and rotates about its normal, as on a ground robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.problems.derived.measurements import Bearings, as_nested_tuples
from rootmatch.problems.derived.problem import DerivedProblem
from rootmatch.problems.derived.store import shipped_formulas
from rootmatch.problems.derived.tables import DerivedTables
from rootmatch.problems.points import PointSets
from rootmatch.problems.two_images import TwoImageProblem


@dataclass(frozen=True)
class PlanarMotion(TwoImageProblem):
    """Relative pose of two images from two points, the camera moving in a plane (Ortín & Montiel 2001).

    Pass it to `rootmatch.match`; its methods are only needed to write problems or samplers.

    The unknown is x = tan(θ/2) of the rotation θ about the plane's normal that takes the first view to the second; it
    belongs to the cameras, so all pairs share it. The direction of the motion within the plane is eliminated. Pixels of
    the first image are the source, of the second the target.

    Parameters
    ----------
    camera : Camera
        Of the first image.
    camera2 : Camera, optional
        Of the second image; the first one by default.
    axis, axis2 : three floats
        The plane's normal (for a robot on a floor: down) in the frame of the first and of the second camera. Any length
        but 0; for a camera fixed to a robot both are the same, so the second one is the first unless it is given.

    Raises
    ------
    InputError
        If a camera or a direction is missing or cannot be used.

    Notes
    -----
    A hyper-edge of three correspondences has one constraint. Points must lie in front of both cameras.

    The floor is taken to be exactly flat. If it tilts the camera by some tenths of a degree, which is many pixels, use
    `ThreePlusOne` with its `axis_noise`.

    Degenerate: no motion, or a rotation alone (every pair's quadratic has a double root at the truth, and residuals
    lose their power); points of the plane through the camera centres (the horizon of a level camera): they stay there
    whatever the motion, so correspondences among them carry no information; two correspondences on one vertical line of
    each image carry little; θ = π puts x at infinity.
    """

    planar: ClassVar[bool] = True
    name: ClassVar[str] = "planar"
    minimal: ClassVar[int] = 2
    degree: ClassVar[int] = 2
    constraints: ClassVar[int] = 1
    min_for_pose: ClassVar[int] = 3

    def __post_init__(self) -> None:
        if np.size(self.axis2) == 0:
            self.__dict__.update(axis2=self.axis)
        super().__post_init__()

    @property
    def derived(self) -> DerivedProblem:
        """The generated problem behind it, on rays rotated so that the normal is y."""
        measured = (
            Bearings(camera, as_nested_tuples(turn))
            for camera, turn in zip(self.cameras, self.rotations(), strict=True)
        )
        return DerivedProblem(self.name, shipped_formulas("planar_motion"), *measured)

    def tables(self, points: PointSets) -> DerivedTables:
        """Tables for the kernels; see `Problem.tables`."""
        return self.derived.tables(points)

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """Quadratics (E, 3), highest degree first, of minimal sets of pixels (E, 2, 2) and (E, 2, 2)."""
        return self.derived.coefficients(source, target)

"""Planar motion: two images from a camera that moves in a plane and turns about its normal, as on a ground robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.camera import Camera, Vector, turn_to_y, unit_direction
from rootmatch.kernels.derived.tables import DerivedTables
from rootmatch.problems.derived.measurements import Bearings
from rootmatch.problems.derived.problem import DerivedProblem
from rootmatch.problems.derived.shipped import shipped
from rootmatch.problems.problem import Problem


@dataclass(frozen=True)
class PlanarMotion(Problem):
    """Relative pose of two images from two points, the camera moving in a plane (Ortín & Montiel 2001).

    The unknown is x = tan(θ/2) of the turn θ about the plane's normal that takes the first view to the second; it
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
        but 0; for a camera fixed to a robot both are the same.

    Notes
    -----
    A hyper-edge of three correspondences has one constraint. Points must lie in front of both cameras.

    Degenerate: no motion, or a turn alone (every pair's quadratic vanishes at the truth twice; residuals fade by
    themselves); points of the plane through the camera centres (the horizon of a level camera): they stay there
    whatever the motion, so their correspondences with each other say nothing; two correspondences on one vertical line
    of each image say little; θ = π puts x at infinity.
    """

    camera: Camera
    camera2: Camera | None = None
    axis: Vector = (0.0, 1.0, 0.0)
    axis2: Vector = (0.0, 1.0, 0.0)
    name: ClassVar[str] = "planar"
    order: ClassVar[int] = 3
    minimal: ClassVar[int] = 2
    degree: ClassVar[int] = 2
    constraints: ClassVar[int] = 1
    pair_count: ClassVar[int] = 3
    source_dimension: ClassVar[int] = 2
    to_check: ClassVar[str] = "cameras and axes"

    def __post_init__(self) -> None:
        unit_direction(self.axis, "axis")
        unit_direction(self.axis2, "axis2")

    @property
    def derived(self) -> DerivedProblem:
        """The generated problem behind it, on rays turned so that the normal is y."""
        first, second = turn_to_y(self.axis, "axis"), turn_to_y(self.axis2, "axis2")
        return DerivedProblem(
            self.name,
            shipped("planar_motion"),
            Bearings(self.camera, nested(first)),
            Bearings(self.camera2 or self.camera, nested(second)),
        )

    def prepare(
        self, source: ArrayLike, target: ArrayLike, noise: ArrayLike = 1.0, normals: ArrayLike | None = None
    ) -> DerivedTables:
        """Tables for the kernels; noise as of `ThreePlusOne`: a pair gives source and target apart."""
        return self.derived.prepare(source, target, noise, normals)

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """Quadratics (E, 3), highest degree first, of minimal sets of pixels (E, 2, 2) and (E, 2, 2)."""
        return self.derived.coefficients(source, target)


def nested(matrix: NDArray[np.float64]) -> tuple[tuple[float, ...], ...]:
    """A matrix as nested tuples, which frozen options can hold."""
    return tuple(tuple(float(value) for value in row) for row in matrix)


def derivation(camera: Camera) -> DerivedProblem:
    """The problem from its equation, as the shipped formulas were generated (needs the extra ``symbolic``)."""
    import sympy as sp

    from rootmatch.problems.symbolic import derive

    x, tx, tz = sp.symbols("x tx tz")
    turn = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])  # (1 + x²) R
    move = sp.Matrix([tx, 0, tz])

    def depths(p: Any, q: Any, t: Any) -> list[Any]:
        """Depths in both views of the point seen along p and q, each times a positive number."""
        r = turn * p
        return [q.cross(t).dot(r.cross(q)), t.cross(r).dot(q.cross(r))]

    def positive(X: list[Any], u: list[Any]) -> list[Any]:
        # the first correspondence gives the direction of the motion, up to its sign: all depths have the same
        normal = (turn * X[0]).cross(u[0])
        t = sp.Matrix([-normal[2], 0, normal[0]])
        first, *others = [depth for p, q in zip(X, u, strict=True) for depth in depths(p, q, t)]
        return [first * other for other in others]

    return derive(
        "planar_motion",
        each=lambda p, q: q.dot(move.cross(turn * p)),
        positive=positive,
        minimal=2,
        shared=x,
        eliminate=[tx, tz],
        source=Bearings(camera),
        target=Bearings(camera),
        cached=False,
    )

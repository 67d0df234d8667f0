"""Upright pose with unknown focal length: points in space and their image, the vertical known, the zoom not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rootmatch.camera import Vector, turn_to_y, unit_direction
from rootmatch.errors import InputError
from rootmatch.kernels.derived.tables import DerivedTables
from rootmatch.problems.derived.measurements import Points, Uncalibrated
from rootmatch.problems.derived.problem import DerivedProblem
from rootmatch.problems.derived.shipped import shipped
from rootmatch.problems.planar_motion import nested
from rootmatch.problems.problem import Problem


@dataclass(frozen=True)
class UP2PF(Problem):
    """Pose and focal length of an upright camera with square pixels and a known principal point.

    With the vertical known a correspondence of a point X and a pixel gives two equations in the turn θ about the
    vertical, the translation and the focal length f (compare Kukelova et al. 2010, who add radial distortion). Three
    points determine the five unknowns and leave one constraint; a hyper-edge of four has three. Of each pair of points
    the translation goes as in `UP2P`, which leaves an equation that is linear in f; f is eliminated between two such.
    The unknown that all share is x = tan(θ/2).

    Parameters
    ----------
    centre : two floats
        Principal point in pixels.
    vertical_camera, vertical_world : three floats
        The same direction (say down) in the camera frame and in the frame of the points. Any length but 0.

    Notes
    -----
    Degenerate: no perspective, that is points at nearly one depth: focal length and distance trade places and only
    their ratio is determined, so residuals fade by themselves; two points of a minimal set on one vertical line; θ = π
    puts x at infinity. Both signs of f solve the equations; f > 0 is demanded.
    """

    centre: tuple[float, float]
    vertical_camera: Vector = (0.0, 1.0, 0.0)
    vertical_world: Vector = (0.0, 1.0, 0.0)
    name: ClassVar[str] = "up2pf"
    order: ClassVar[int] = 4
    minimal: ClassVar[int] = 3
    degree: ClassVar[int] = 4
    constraints: ClassVar[int] = 3
    pair_count: ClassVar[int] = 6
    source_dimension: ClassVar[int] = 3
    to_check: ClassVar[str] = "units, centre and both verticals"
    to_tell: ClassVar[str] = "give the focal length to `UP2P` where it is known"

    def __post_init__(self) -> None:
        unit_direction(self.vertical_camera, "vertical_camera")
        unit_direction(self.vertical_world, "vertical_world")
        centre = np.asarray(self.centre, dtype=float)
        if centre.shape != (2,) or not np.all(np.isfinite(centre)):
            raise InputError(f"centre: {self.centre!r} given; give the principal point, two numbers of pixels")

    @property
    def derived(self) -> DerivedProblem:
        """The generated problem behind it, on points and rays turned so that the vertical is y."""
        camera = turn_to_y(self.vertical_camera, "vertical_camera")
        # a turn about y is what is unknown anyway: one that brings the optical axis into the plane x = 0 saves a symbol
        axis = camera[:, 2]
        size = float(np.hypot(axis[0], axis[2]))
        if size > 0.0:
            c, s = axis[2] / size, axis[0] / size
            camera = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) @ camera
        return DerivedProblem(
            self.name,
            shipped("up2pf"),
            Points(3),
            Uncalibrated((float(self.centre[0]), float(self.centre[1])), nested(camera)),
        )

    def prepare(
        self, source: ArrayLike, target: ArrayLike, noise: ArrayLike = 1.0, normals: ArrayLike | None = None
    ) -> DerivedTables:
        """Tables for the kernels; see `Problem.prepare`."""
        return self.derived.prepare(self._turned(source), target, noise, normals)

    def coefficients(self, source: ArrayLike, target: ArrayLike) -> NDArray[np.float64]:
        """Quartics (E, 5) in x, θ counted from the optical axis, of minimal sets (E, 3, 3) and (E, 3, 2)."""
        return self.derived.coefficients(self._turned(source), target)

    def _turned(self, source: ArrayLike) -> Any:
        points = np.asarray(source)
        if points.ndim < 2 or points.shape[-1] != 3 or points.dtype.kind not in "fiu":
            return source  # the checks further on say what is wrong
        return points @ turn_to_y(self.vertical_world, "vertical_world").T


def derivation() -> DerivedProblem:
    """The problem from its equations, as the shipped formulas were generated (needs the extra ``symbolic``)."""
    import sympy as sp

    from rootmatch.problems.symbolic import derive

    x, f = sp.symbols("x f")
    turn = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])  # (1 + x²) R

    def pair(X: list[Any], u: list[Any], i: int, j: int) -> Any:
        """What vanishes: n · R (X_j − X_i), n the normal of the plane of both rays w + f z, z = (0, zy, zz)."""
        rays = [sp.Matrix([v[0], v[1] + f * v[4], v[2] + f * v[5]]) for v in (u[i], u[j])]
        return rays[0].cross(rays[1]).dot(turn * (X[j] - X[i]))

    def positive(X: list[Any], u: list[Any]) -> list[Any]:
        # the first pair's equation a f + b = 0 gives f
        equation = pair(X, u, 0, 1)
        return [-equation.subs(f, 0) * sp.diff(equation, f).subs(f, 0)]

    # checked with a camera that looks somewhat down: nothing of the optical axis but zx vanishes
    c, s = np.cos(0.3), np.sin(0.3)
    tilt = ((1.0, 0.0, 0.0), (0.0, c, s), (0.0, -s, c))
    return derive(
        "up2pf",
        lambda X, u: [pair(X, u, 0, 1), pair(X, u, 0, 2), pair(X, u, 1, 2)],
        positive=positive,
        minimal=3,
        shared=x,
        eliminate=[f],
        source=Points(3),
        target=Uncalibrated((0.0, 0.0), tilt),
        cached=False,
    )

"""The equations of the derived problems that come with the package, and the command that writes their formulas anew.

python -m rootmatch.derivation.shipped
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy as sp

from rootmatch.cameras.pinhole import Camera
from rootmatch.derivation.derive import derive
from rootmatch.problems.derived.measurements import Bearings, Points, Uncalibrated
from rootmatch.problems.derived.problem import DerivedProblem
from rootmatch.problems.derived.store import shipped_file


def planar_motion(camera: Camera) -> DerivedProblem:
    """The problem from its equation, as the shipped formulas were generated (needs the extra ``symbolic``)."""
    x, tx, tz = sp.symbols("x tx tz")
    rotation = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])  # (1 + x²) R
    move = sp.Matrix([tx, 0, tz])

    def depths(p: Any, q: Any, t: Any) -> list[Any]:
        """Depths in both views of the point observed along p and q, each times a positive number."""
        r = rotation * p
        return [q.cross(t).dot(r.cross(q)), t.cross(r).dot(q.cross(r))]

    def positive(X: list[Any], u: list[Any]) -> list[Any]:
        # the first correspondence gives the direction of the motion, up to its sign: all depths have the same
        normal = (rotation * X[0]).cross(u[0])
        t = sp.Matrix([-normal[2], 0, normal[0]])
        first, *others = [depth for p, q in zip(X, u, strict=True) for depth in depths(p, q, t)]
        return [first * other for other in others]

    return derive(
        "planar_motion",
        each=lambda p, q: q.dot(move.cross(rotation * p)),
        positive=positive,
        minimal=2,
        shared=x,
        eliminate=[tx, tz],
        source=Bearings(camera),
        target=Bearings(camera),
        cached=False,
    )


def up2pf() -> DerivedProblem:
    """The problem from its equations, as the shipped formulas were generated (needs the extra ``symbolic``)."""
    x, f = sp.symbols("x f")
    rotation = sp.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])  # (1 + x²) R

    def pair(X: list[Any], u: list[Any], i: int, j: int) -> Any:
        """What vanishes: n · R (X_j − X_i), n the normal of the plane of both rays w + f z, z = (0, zy, zz)."""
        rays = [sp.Matrix([v[0], v[1] + f * v[4], v[2] + f * v[5]]) for v in (u[i], u[j])]
        return rays[0].cross(rays[1]).dot(rotation * (X[j] - X[i]))

    def positive(X: list[Any], u: list[Any]) -> list[Any]:
        # the first pair's equation a f + b = 0 gives f
        equation = pair(X, u, 0, 1)
        return [-equation.subs(f, 0) * sp.diff(equation, f).subs(f, 0)]

    # checked with a camera that points somewhat down: nothing of the optical axis but zx vanishes
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


def regenerate() -> None:
    """Write all shipped formulas from their equations."""
    camera = Camera(1000.0, 1000.0, 320.0, 240.0)
    for problem, derived in (("planar_motion", planar_motion(camera)), ("up2pf", up2pf())):
        shipped_file(problem).write_text(derived.code, encoding="utf-8")


if __name__ == "__main__":
    regenerate()

"""Products of vectors in space, component by component, as scalar kernels have no arrays."""

from __future__ import annotations

from rootmatch.jit.decorators import scalar


@scalar
def dot(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Scalar product."""
    return ax * bx + ay * by + az * bz


@scalar
def cross(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Vector product."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@scalar
def tangents(x, y, z):  # type: ignore[no-untyped-def]
    """Two unit vectors across a unit vector and each other, without a branch (Duff et al. 2017)."""
    sign = 1.0 if z >= 0.0 else -1.0
    w = -1.0 / (sign + z)
    v = x * y * w
    return (1.0 + sign * x * x * w, sign * v, -sign * x), (v, sign + y * y * w, -y)

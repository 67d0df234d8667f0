"""Products of vectors in space, component by component, as scalar kernels have no arrays."""

from __future__ import annotations

from rootmatch.kernels.dispatch import scalar


@scalar
def dot(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Scalar product."""
    return ax * bx + ay * by + az * bz


@scalar
def cross(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Vector product."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx

"""Poses after steps, compiled."""

from __future__ import annotations

import math

from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part

SMALL = 1e-6
"""Angle in radians below which the series of sine and cosine are cut after the first term."""


@part
def take_one_step(k, steps, rotations, positions, longest, turned, moved):  # type: ignore[no-untyped-def]
    """As `take_steps` for the k-th pose, into ``turned`` and ``moved``, which may be the poses themselves."""
    x, y, z = steps[k, 0], steps[k, 1], steps[k, 2]
    a, b, c = steps[k, 3], steps[k, 4], steps[k, 5]
    p, q, r = positions[k, 0], positions[k, 1], positions[k, 2]
    angle = math.sqrt(x * x + y * y + z * z)
    distance = max(math.sqrt(p * p + q * q + r * r), 1e-300)
    length = max(angle, math.sqrt(a * a + b * b + c * c) / distance)
    share = min(1.0, longest / max(length, 1e-300))
    x, y, z, angle = share * x, share * y, share * z, share * angle
    moved[k, 0], moved[k, 1], moved[k, 2] = p + share * a, q + share * b, r + share * c
    s, h = 1.0, 0.5
    if angle > SMALL:
        half = math.sin(0.5 * angle) / angle
        s, h = math.sin(angle) / angle, 2.0 * half * half
    for j in range(3):
        u, v, w = rotations[k, 0, j], rotations[k, 1, j], rotations[k, 2, j]
        # R + s ω × R + h ω × (ω × R), column by column
        e, f, g = y * w - z * v, z * u - x * w, x * v - y * u
        turned[k, 0, j] = u + s * e + h * (y * g - z * f)
        turned[k, 1, j] = v + s * f + h * (z * e - x * g)
        turned[k, 2, j] = w + s * g + h * (x * f - y * e)


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def take_steps(steps, rotations, positions, longest, out):  # type: ignore[no-untyped-def]
    """Poses after steps (K, 6) of (ω, τ), each shortened where first order may not hold.

    Parameters
    ----------
    steps, rotations, positions : (K, 6), (K, 3, 3) and (K, 3) arrays
    longest : float
        Length of a step, in radians and relative to the distance of the body.
    out : tuple
        Rotations (K, 3, 3) and positions (K, 3), filled.
    """
    steps, rotations, positions, out = borrow((steps, rotations, positions, out))
    for k in range(steps.shape[0]):
        take_one_step(k, steps, rotations, positions, longest, out[0], out[1])

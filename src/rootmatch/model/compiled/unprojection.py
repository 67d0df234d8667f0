"""Rays of detections by cameras whose lens is turned back along its radius alone, compiled."""

from __future__ import annotations

import math

import numpy as np

from rootmatch.cameras.lens import STEPS
from rootmatch.jit.borrowed_arrays import borrow
from rootmatch.jit.decorators import FASTMATH, driver, part
from rootmatch.model.compiled.projection import KANNALA_BRANDT

ROUNDED = 4e-16
"""Relative step of a root finder below which it has arrived."""


@part
def fisheye_radius(numbers, angle):  # type: ignore[no-untyped-def]
    """Radius of the image of directions at an angle to the axis of a fisheye lens, and its derivative."""
    s = angle * angle
    k1, k2, k3, k4 = numbers[4], numbers[5], numbers[6], numbers[7]
    radius = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    return radius, 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))


@part
def solve_fisheye_angle(numbers, wanted):  # type: ignore[no-untyped-def]
    """Angle at which a fisheye lens has that radius: Newton's method in brackets, as `cameras.lens.increasing_root`."""
    low, high = 0.0, numbers[8]
    angle = min(wanted, 0.999 * high)
    for _ in range(STEPS):
        radius, slope = fisheye_radius(numbers, angle)
        if radius <= wanted:
            low = angle
        else:
            high = angle
        new = angle - (radius - wanted) / slope
        if not (low <= new <= high):
            new = 0.5 * (low + high)
        change, angle = abs(new - angle), new
        if change <= ROUNDED * angle:
            break
    return angle


@driver(nogil=True, fastmath=FASTMATH, error_model="numpy")
def unproject(target, camera_of, views, rays):  # type: ignore[no-untyped-def]
    """Unit rays (n', 3) of detections (n', 2), NaN where a lens shows nothing, into ``rays``.

    Parameters
    ----------
    target : (n', 2) array
    camera_of : (n',) int64 array
        The camera of each, in whose frame its ray is.
    views : tuple
        Kinds (C,) of cameras, pinhole or fisheye, with their numbers and offsets: as in
        `rootmatch.model.compiled.projection.linearise`.
    rays : (n', 3) array
    """
    target, camera_of, views, rays = borrow((target, camera_of, views, rays))
    kinds, numbers, offsets = views
    for j in range(target.shape[0]):
        k = camera_of[j]
        own = numbers[k]
        x = (target[j, 0] - offsets[k, 0] - own[2]) / own[0]
        y = (target[j, 1] - offsets[k, 1] - own[3]) / own[1]
        across = math.sqrt(x * x + y * y)
        if kinds[k] == KANNALA_BRANDT:
            angle = solve_fisheye_angle(own, across) if across < fisheye_radius(own, own[8])[0] else np.nan
            z, scale = math.cos(angle), math.sin(angle) / across if across > 0.0 else 1.0
        else:
            z = scale = 1.0 / math.sqrt(across * across + 1.0)
        rays[j, 0], rays[j, 1], rays[j, 2] = scale * x, scale * y, z

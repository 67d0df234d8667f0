"""Validation of points, normals and noise: one clear error for each mistake."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Floats, as_floats, as_points
from rootmatch.errors import InputError

MAXIMUM, MINIMUM = 1e100, 1e-100
"""Greatest coordinate and least extent of points, in their unit: their squares and products are still numbers."""

MAX_POINTS = 10_000
"""Points of a set: their distances, three numbers for each two points, then take 2.4 GB."""


def check_points(
    points: ArrayLike, dimension: int, name: str, minimum: int, distinct: bool = True, *, of: str
) -> Floats:
    """Points as a contiguous float array, or one clear error that says what is wrong with them.

    Parameters
    ----------
    points : (m, dimension) array
    dimension : int
        2 or 3.
    name : str
        ``"source"`` or ``"target"``, for the message.
    minimum : int
        How many points the problem needs.
    distinct : bool
        Whether no two may be the same.
    of : str
        What needs so many, for the message.
    """
    array = as_points(points, dimension, name)
    if array.shape == (0,):  # an empty list
        array = array.reshape(0, dimension)
    if array.ndim != 2 or array.shape[1] != dimension:
        of_image = name == "source" and dimension == 3 and array.shape[1:] == (2,)
        hint = "; for two images use ThreePlusOne or PlanarMotion" if of_image else ""
        if array.ndim == 2 and array.shape[0] == dimension:
            hint = "; is it transposed? Give one point a row"
        raise InputError(f"{name}: shape {array.shape} given, (m, {dimension}) expected{hint}")
    if len(array) > MAX_POINTS:
        raise InputError(f"{name}: {len(array):,} points given; give at most {MAX_POINTS:,}")
    if not float(np.abs(array).max(initial=0.0)) <= MAXIMUM:
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if len(bad):
            raise InputError(f"{name}: point {bad[0]} holds NaN or infinity; remove such points ({len(bad)} in all)")
        far = np.flatnonzero((np.abs(array) > MAXIMUM).any(axis=1))
        raise InputError(f"{name}: point {far[0]} lies beyond {MAXIMUM:g}; choose another unit, or remove it")
    if len(array) < minimum:
        raise InputError(f"{name}: {len(array)} points given, at least {minimum} needed by {of}")
    same = find_repeated(array) if distinct else None
    if same is not None:
        raise InputError(f"{name}: points {same[0]} and {same[1]} are the same; remove repeated points")
    if len(array) > 1 and float(np.abs(array - array[0]).max()) < MINIMUM:
        same = find_repeated(array)
        fault = f"lie within {MINIMUM:g}; choose another unit" if same is None else "are the same; give distinct points"
        raise InputError(f"{name}: all points {fault}")
    return array


def find_repeated(points: Floats) -> tuple[int, int] | None:
    """Indices of two points with the same coordinates; None if all differ."""
    ascending = np.sort(points[:, 0])
    if (ascending[1:] != ascending[:-1]).all():
        return None  # as nearly always
    order = np.lexsort(points.T[::-1])
    same = np.flatnonzero((points[order[1:]] == points[order[:-1]]).all(axis=1))
    if not len(same):
        return None
    first, second = sorted((int(order[same[0]]), int(order[same[0] + 1])))
    return first, second


def check_normals(normals: ArrayLike, count: int) -> Floats:
    """Checked normals (count, 3)."""
    array = as_floats(normals, "normals", f"shape ({count}, 3)")
    if array.shape != (count, 3):
        raise InputError(f"normals: shape {array.shape} given, ({count}, 3) expected, one for each source point")
    if not np.all(np.isfinite(array)):
        raise InputError("normals: NaN or infinity; give 0,0,0 for a point without a known normal")
    return array


MIN_VIEW_ANGLE = np.radians(5.0)
"""Smallest view angle that is taken for one: no light shines so narrowly, and degrees in radians are below. A round
value."""


def check_view_angle(angle: ArrayLike | None, normals: object, count: int) -> Floats | None:
    """Cosines (count,) of view angles from the normals, in radians; None where no angle is given."""
    if angle is None:
        return None
    if normals is None:
        raise InputError(
            "view_angle: it is measured from the normals, but none are given; give normals=, or leave it out"
        )
    try:
        radians = np.asarray(angle, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"view_angle: {angle!r} given; give radians, one number or one for each point") from None
    if radians.shape not in ((), (count,)):
        raise InputError(
            f"view_angle: shape {radians.shape} given; give one number or one for each of {count} source points"
        )
    if not np.all((radians > 0.0) & (radians <= np.pi)):
        raise InputError(
            "view_angle: an angle is not in (0, π]; give radians from the normal, such as 1.22 (np.radians(70))"
        )
    if (minimum := float(np.min(radians))) < MIN_VIEW_ANGLE:
        raise InputError(
            f"view_angle: {minimum:.3g} radians given, {np.degrees(minimum):.3g}°, within which no point is seen; "
            "give radians in Python, such as 1.22, and degrees on the command line, such as --view-angle 70"
        )
    return np.ascontiguousarray(np.broadcast_to(np.cos(radians), (count,)))


def are_collinear(points: Floats) -> bool:
    """Whether points (n, k) all lie on one line: every rotation about it looks the same."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(values[1] <= 1e-9 * values[0])


def check_not_collinear(points: Floats) -> None:
    """Refuse points that all lie on one line."""
    if are_collinear(points):
        raise InputError(
            f"source: all {len(points)} points are collinear, which leaves the pose open; add points off the line"
        )


MIN_NOISE, MAX_NOISE = 1e-6, 1e4
"""Range of the noise of a coordinate in pixels: zero is taken as the least, and the most is wider than an image. Where
the unit is the caller's, a thousandth of the extent of the points stands for a pixel."""


def check_noise(noise: ArrayLike, count: int, pixel: float, name: str = "noise") -> Floats:
    """Standard deviations (count,) of a scalar or an array.

    Zero is taken as a millionth of a pixel: exact data then still yields finite normalised residuals.

    Parameters
    ----------
    noise : float or (count,) array
    count : int
        Points of the set.
    pixel : float
        What counts as a pixel: 1 for an image, a thousandth of the extent of points whose unit is the caller's.
    name : str
        For the message.
    """
    minimum, maximum = MIN_NOISE * pixel, MAX_NOISE * pixel
    if isinstance(noise, float) and 0.0 <= noise <= maximum:
        return np.full(count, max(noise, minimum))
    if noise is None:
        raise InputError(f"{name}: None given; give the standard deviation of a coordinate, or leave it out")
    sigma = as_floats(noise, name, "one number, or one for each target point, in its unit")
    if sigma.shape not in ((), (count,)):
        raise InputError(f"{name}: shape {sigma.shape} given; give one number or one for each of {count} target points")
    if not np.all(np.isfinite(sigma)) or np.any(sigma < 0.0):
        raise InputError(f"{name}: {np.min(sigma):g} given; a standard deviation is finite and not negative")
    if np.any(sigma > maximum):
        wide = "px given, wider than an image" if pixel == 1.0 else "given, more than the distance between points"
        raise InputError(f"{name}: {np.max(sigma):g} {wide}; give the standard deviation of a coordinate")
    return np.ascontiguousarray(np.broadcast_to(np.maximum(sigma, minimum), (count,)))

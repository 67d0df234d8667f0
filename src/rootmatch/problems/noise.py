"""The noise of every point, parsed here and nowhere else.

One σ, one for each point, or a pair for source and target; of points in space also σ of each axis or covariances. Noise
of a model which was measured itself adds to that of its image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Bools, Floats, Integers, as_floats, cache_by_values
from rootmatch.cameras.base import CameraModel
from rootmatch.cameras.calibration_errors import calibration_noise
from rootmatch.cameras.rig import Rig
from rootmatch.errors import InputError
from rootmatch.problems.capabilities import Capability
from rootmatch.problems.checks import MIN_NOISE, check_noise
from rootmatch.problems.points import PointSets

FARTHER = 3.0
"""Distance at which the noise of a model is taken to be seen, over the least plausible one. On seeds from 1000 of
benchmarks/source_noise.py, 1 finds 16 of 20 small bodies among clutter and 3 finds 19; without any noise of the model
in the search 20 are found there, and 14 of 20 large ones where 3 finds 18."""
ROUNDED = 1e-9
"""Of a covariance, over its largest number: what is no lack of symmetry, and no negative eigenvalue. A round value."""


def parse_noise(
    noise: ArrayLike, shape: tuple[int, int], noisy_source: bool, name: str, pixels: tuple[float, float]
) -> tuple[Floats, Floats]:
    """Standard deviations (n,) and (n',) of source and target coordinates.

    Parameters
    ----------
    noise : float, (n',) array, or a pair
        One number holds for both sets; n' numbers are those of the target, and their root mean square that of the
        source; a tuple or list of two gives source and target apart, each a number or one for each point.
    shape : (n, n')
    noisy_source : bool
        Whether the problem has a noisy source. If not, the noise is that of the target alone.
    name : str
        The problem, for the message.
    pixels : two floats
        What counts as a pixel of the source and of the target; see `rootmatch.problems.base.Problem.noise_pixels`.
    """
    n, n_target = shape
    if isinstance(noise, tuple | list) and len(noise) == 2:
        Capability.SOURCE_NOISE.require(noisy_source, name)
        first, second = noise
        return (
            check_noise(first, n, pixels[0], "noise of the source"),
            check_noise(second, n_target, pixels[1], "noise of the target"),
        )
    sigma = check_noise(noise, n_target, pixels[1])
    return np.full(n, np.sqrt(sigma @ sigma / n_target)), sigma


def pixel_equivalent(points: Floats) -> float:
    """A thousandth of the extent of points: as a pixel is of an image, in whatever unit they are given."""
    extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    return 1e-3 * extent if extent > 0.0 else 1.0


def check_source_noise(noise: ArrayLike, points: Floats, name: str = "source_noise") -> Floats:
    """Covariances (n, k, k) of points (n, k).

    Parameters
    ----------
    noise : float, (n,), (n, k) or (n, k, k) array
        σ of a coordinate: of all points, of each, or of each on each axis; or the covariance of each. In the unit of
        the points, or its square.
    points : (n, k) array
    name : str
        For the message.
    """
    covariance = as_covariances(noise, points.shape, name)
    widest = float(np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)).max())
    if widest > float(np.ptp(points, axis=0).max()):
        raise InputError(f"{name}: {widest:g} given, more than the distance between points; give it in their unit")
    return covariance


def as_covariances(noise: ArrayLike, shape: tuple[int, int], name: str) -> Floats:
    """Covariances (n, k, k) of n points with k coordinates, from what `check_source_noise` takes."""
    n, k = shape
    expected = f"give σ as one number, ({n},) or ({n}, {k}), or covariances ({n}, {k}, {k})"
    values = as_floats(noise, name, expected)
    if values.shape not in ((), (n,), (n, k), (n, k, k)):
        raise InputError(f"{name}: shape {values.shape} given; {expected}")
    if not np.isfinite(values).all():
        raise InputError(f"{name}: it holds NaN or infinity; {expected}")
    if values.ndim < 3:
        if (values < 0.0).any():
            raise InputError(f"{name}: {values.min():g} given; a standard deviation is not negative")
        sigma = np.broadcast_to(values if values.ndim == 2 else values.reshape(-1, 1), (n, k))
        covariance = sigma[:, :, None] ** 2 * np.eye(k)
    else:
        largest = np.abs(values).max(axis=(1, 2))[:, None, None]
        if (np.abs(values - values.swapaxes(1, 2)) > ROUNDED * largest).any():
            raise InputError(f"{name}: a covariance is not symmetric; give ({n}, {k}, {k}) covariances")
        covariance = 0.5 * (values + values.swapaxes(1, 2))
        if (np.linalg.eigvalsh(covariance) < -ROUNDED * largest[:, 0]).any():
            raise InputError(f"{name}: a covariance has a negative eigenvalue; give positive semidefinite ones")
    return np.ascontiguousarray(covariance)


def _dimensions(noise: ArrayLike, name: str = "noise") -> int:
    """Dimensions of a noise; `InputError` if it is no array."""
    try:
        return np.ndim(noise)
    except ValueError:
        raise InputError(f"{name}: rows of different lengths given; give one number, or one for each point") from None


def detection_covariances(noise: ArrayLike, count: int) -> Floats | None:
    """Covariances (n', 2, 2) of so many detections, px²; None if one σ for both axes is given.

    Raises `InputError` if they are no covariances, or one says that a coordinate is exact.
    """
    if isinstance(noise, int | float) or _dimensions(noise) < 2:
        return None
    covariance = as_covariances(noise, (count, 2), "noise")
    minimum = float(np.linalg.eigvalsh(covariance)[:, 0].min(initial=np.inf))
    if minimum < MIN_NOISE**2:
        raise InputError(
            f"noise: a covariance has the eigenvalue {max(minimum, 0.0):g} px², so a detection is exact along an axis; "
            "add the variance across the blur, such as 0.1"
        )
    return covariance


def split_noise(noise: Any, first: Floats, second: Floats) -> tuple[Any, Floats | None, Floats | None]:
    """The noise of two point sets as one σ for all axes of a point, and covariances where axes differ.

    Parameters
    ----------
    noise : float, array or pair
        As `parse_noise` takes it, or with (n, k) or (n, k, k) for the n of a set.
    first, second : (n, k) and (n', k) arrays
        The points.

    Returns
    -------
    noise : float, array or pair
        As `parse_noise` takes it.
    source_covariance, target_covariance : (n, k, k) and (n', k, k) arrays or None
    """
    pair = isinstance(noise, tuple | list) and len(noise) == 2

    def split(part: Any, points: Floats, name: str) -> tuple[Any, Floats | None]:
        known = as_covariances(part, points.shape, name) if _dimensions(part, name) > 1 else None
        return part if known is None else mean_deviation(known), known

    if not pair:
        sigma, covariance = split(noise, second, "noise")
        return sigma, None, covariance
    of_source, of_target = split(noise[0], first, "noise of the source"), split(noise[1], second, "noise of the target")
    return (of_source[0], of_target[0]), of_source[1], of_target[1]


def mean_deviation(covariance: Floats) -> Floats:
    """One standard deviation (n,) of a coordinate of each point by its covariance (n, k, k)."""
    return np.asarray(np.sqrt(np.trace(covariance, axis1=1, axis2=2) / covariance.shape[-1]))


def add_model_noise(points: PointSets, camera: CameraModel) -> PointSets:
    """Points whose detections have the noise of the model in theirs, as a search without a pose takes it.

    One number for all points, at a distance that is plausible: `FARTHER` times that at which the points of the model
    spread as far as all detections do, clutter among them.
    """
    if points.source_covariance is None:
        return points
    own, total = points.detection_noise, points.detection_noise.copy()
    far = FARTHER * _apparent_size(points.source)
    relative = float(np.sqrt((mean_deviation(points.source_covariance) ** 2).mean())) / far
    for rows, (seen, spread, per_pixel) in _spread_by_camera(camera, points.target):
        total[rows[seen]] = np.hypot(own[rows[seen]], relative * spread / per_pixel)
    return replace(points, target_noise=total, noise_alone=own)


def add_calibration_noise(points: PointSets, camera: CameraModel, axes: Floats) -> tuple[PointSets, Floats]:
    """Points whose detections have the errors of a camera's calibration in their noise, and that part (n',) of it.

    As if each had errors of its own, as large as what a pose leaves of them: what they share is told of the pose alone.
    The body is as far as it would spread like the detections, as `add_model_noise` takes it to be, or as the cameras of
    a rig are apart if that is farther: whatever leaves more. ``axes`` (a, 3): about which it may turn.
    """
    size, apart = _apparent_size(points.source), _apparent_size(camera.centres) if isinstance(camera, Rig) else 0.0
    spread = max(spread for _, (_, spread, _) in _spread_by_camera(camera, points.target))
    minimum = size / spread if spread > 0.0 else size
    distances = sorted({max(distance, apart) for distance in (minimum, FARTHER * minimum)})
    more = calibration_noise(camera, points.target, size, distances, axes)
    return add_detection_noise(points, more**2), more


def add_detection_noise(points: PointSets, variances: Floats) -> PointSets:
    """Points whose detections have so much (n',) more variance on each axis, or less."""
    alone, known = points.noise_alone, points.target_covariance
    return replace(
        points,
        target_noise=np.sqrt(points.target_noise**2 + variances),
        noise_alone=None if alone is None else np.sqrt(alone**2 + variances),
        target_covariance=None if known is None else known + variances[:, None, None] * np.eye(2),
    )


def _apparent_size(source: Floats) -> float:
    """Size of a body in an image at unit distance, as two of three coordinates show it."""
    centred = source - source.mean(axis=0)
    return float(np.sqrt(2.0 / 3.0 * (centred**2).sum(axis=1).mean()))


def _spread_by_camera(camera: CameraModel, target: Floats) -> Iterator[tuple[Integers, tuple[Bools, float, Floats]]]:
    """The detections of each camera that has any, with their `_detection_spread`."""
    every = camera.cameras if isinstance(camera, Rig) else [camera]
    of = target[:, 2] if isinstance(camera, Rig) else np.zeros(len(target))
    for k, one in enumerate(every):
        rows = np.flatnonzero(of == k)
        if len(rows):
            yield rows, _detection_spread(one, np.ascontiguousarray(target[rows, : one.dimension]))


@cache_by_values(32)
def _detection_spread(camera: CameraModel, target: Floats) -> tuple[Bools, float, Floats]:
    """Of detections, which directions (m,) they have; the spread of these, and a pixel there (seen,), in radians.

    Every body of a frame, and every search for it, asks this of the same detections.
    """
    rays = camera.seen_bearings(target)
    seen = np.asarray(np.isfinite(rays).all(axis=1))
    rays = rays[seen]
    spread = float(np.sqrt(((rays - rays.mean(axis=0)) ** 2).sum(axis=1).mean())) if len(rays) else 0.0
    return seen, spread, camera.angular_noise(target[seen], np.ones(len(rays)), rays)

"""Validation of arguments and options: their type, their range, and one clear error for each mistake."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Bools, Floats, Integers, as_floats
from rootmatch.cameras.rig import Rig
from rootmatch.cameras.vertical import unit_direction
from rootmatch.errors import InputError, quote_value
from rootmatch.problems.base import Problem
from rootmatch.problems.noise import add_calibration_noise, as_covariances
from rootmatch.problems.points import PointSets
from rootmatch.problems.up2p import UP2P

LARGEST_PRIOR = 1e9
"""Largest prior weight of a correspondence: it is added to weights of hyper-edges, at most 1 each, which then lose 1e-7
to rounding."""


def split_candidates(candidates: ArrayLike | None, n: int, n_target: int) -> tuple[Bools | None, Floats | None]:
    """Mask and prior weights of the candidates argument."""
    if candidates is None:
        return None, None
    unary = np.ascontiguousarray(as_floats(candidates, "candidates", f"a mask or prior weights ({n}, {n_target})"))
    if unary.shape != (n, n_target):
        raise InputError(f"candidates: shape {unary.shape} given, (n, n') = ({n}, {n_target}) expected")
    if not np.all(np.isfinite(unary)) or np.any(unary < 0.0):
        raise InputError("candidates: weights must be finite and not negative; 0 forbids a correspondence")
    mask = unary > 0.0
    if np.any(unary > LARGEST_PRIOR):
        raise InputError(
            f"candidates: a weight of {unary.max():g} given, at most {LARGEST_PRIOR:g} expected; scale all of them"
        )
    if not mask.any():
        raise InputError("candidates: no pair is allowed; allow at least as many as a hyper-edge has")
    return mask, None if np.asarray(candidates).dtype == np.bool_ else unary


def join_camera_noise(rig: Rig | None, noise: Any, target: ArrayLike) -> Any:
    """Noise of a rig's detections as one number or array: a list may have one of these for each camera.

    A list of as many numbers as detections is of these.
    """
    if rig is None or not isinstance(noise, tuple | list):
        return noise
    rows, cameras, numbers = rig.joined(target), len(rig.views), all(isinstance(one, Real) for one in noise)
    rows = np.zeros((0, 3)) if rows.size == 0 else rows
    of_detections = len(noise) == len(rows) and (numbers or len(noise) != cameras)
    if rows.ndim != 2 or of_detections or (numbers and len(noise) != cameras):
        return noise
    if len(noise) != cameras:
        raise InputError(
            f"noise: a list of {len(noise)} given, but the rig has {cameras} cameras and {len(rows)} detections; "
            "give one number, an array with one for each detection, or a list of these, one for each camera"
        )
    each = [as_floats(one, f"noise of camera {k}", "a number or one for each detection") for k, one in enumerate(noise)]
    by_axis, own = any(one.ndim > 1 for one in each), [rows[:, 2] == k for k in range(cameras)]
    joined = np.empty((len(rows), 2, 2) if by_axis else len(rows))
    for k, (of_camera, sigma) in enumerate(zip(own, each, strict=True)):
        count = int(of_camera.sum())
        if sigma.ndim and len(sigma) != count:
            raise InputError(f"noise: {len(sigma)} given for camera {k}, which has {count} detections; give as many")
        joined[of_camera] = as_covariances(sigma, (count, 2), f"noise of camera {k}") if by_axis else sigma
    return joined


def check_indices(indices: ArrayLike, points: int, order: int, name: str) -> Integers:
    """Indices (E, order) of points, distinct within each hyper-edge."""
    array = np.asarray(indices)
    if array.ndim != 2 or array.shape[1] != order or not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"{name}: {array.dtype} of shape {array.shape} given, integers of shape (E, {order}) expected")
    if array.size and (array.min() < 0 or array.max() >= points):
        raise InputError(
            f"{name}: indices {array.min()} to {array.max()} given; there are {points} points, 0 to {points - 1}"
        )
    ordered = np.sort(array, axis=1)
    if np.any(ordered[:, 1:] == ordered[:, :-1]):
        raise InputError(f"{name}: a hyper-edge names a point twice; its correspondences must be distinct")
    return np.ascontiguousarray(array, dtype=np.int64)


def check_not_exact(noise: Any) -> None:
    """Refuse a noise of zero of any target point: no pose would fit a measured one."""
    of_target = noise[1] if isinstance(noise, tuple | list) and len(noise) == 2 else noise
    if isinstance(of_target, int | float) and of_target != 0.0:
        return
    try:
        sigma = np.asarray(of_target, np.float64)
        exact = (sigma if sigma.ndim < 3 else np.trace(sigma, axis1=1, axis2=2)) == 0.0
    except (TypeError, ValueError):
        return  # which is refused with the points
    if exact.any():
        raise InputError(
            "noise: 0 given, which no measured point can fit; give the standard deviation of a coordinate of the "
            "target in its unit, such as 0.3 pixels, or a small one for exact points"
        )


def check_size(shape: tuple[int, int], count: float, limit: int) -> None:
    """Refuse an exhaustive sweep beyond the limit, with its size and the alternatives."""
    if count > limit:
        raise InputError(
            f"{shape[0]} source against {shape[1]} target points are {count:.3g} hyper-edges or minimal sets, above "
            f'the limit of {limit:.3g}; use sampler="random" with samples=…, name candidates, or raise max_evaluations='
        )


def check_problem(problem: Any) -> None:
    """Refuse anything but a problem, its class included."""
    if not isinstance(problem, Problem):
        if isinstance(problem, type):
            raise InputError(
                f"problem: the class {problem.__name__} was given; pass an instance, such as rootmatch.P3P(camera)"
            )
        raise InputError(f"problem: {quote_value(problem)} given; give a problem such as rootmatch.P3P(camera)")


def check_choice(name: str, value: Any, choices: tuple[str, ...]) -> None:
    """Refuse a value that is not one of the choices."""
    if value not in choices:
        raise InputError(f"{name}: {value!r} given; one of {', '.join(choices)} expected")


def check_motions(motions: Any) -> None:
    """Refuse anything but a positive whole number or ``"auto"``."""
    whole = isinstance(motions, Integral) and not isinstance(motions, bool) and int(motions) >= 1
    if not whole and not (isinstance(motions, str) and motions == "auto"):
        raise InputError(f'motions: {quote_value(motions)} given; give a whole number of at least 1, or "auto"')


def check_count(name: str, value: Any, minimum: int = 1) -> None:
    """Refuse anything but a whole number of at least ``minimum``; None passes."""
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < minimum:
        raise InputError(f"{name}: {quote_value(value)} given; give a whole number of at least {minimum}")


def check_positive(name: str, value: Any) -> None:
    """Refuse anything but a positive, finite number; None passes."""
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < float("inf"):
        raise InputError(f"{name}: {quote_value(value)} given; give a positive number")


def check_probability(name: str, value: Any) -> None:
    """Refuse anything but a number above 0 and at most 1; None passes."""
    check_positive(name, value)
    if value is not None and float(value) > 1.0:
        raise InputError(f"{name}: {quote_value(value)} given; give a probability above 0, at most 1")


def check_callable(name: str, value: Any, purpose: str) -> None:
    """Refuse anything that cannot be called, classes included; None passes."""
    if value is not None and (isinstance(value, type) or not callable(value)):
        raise InputError(f"{name}: {quote_value(value)} given; give {purpose}")


def allow_for_calibration(problem: Problem, points: PointSets) -> tuple[PointSets, Floats | None]:
    """Points with the errors of a calibration in their noise, and that part (n',) of it; None if it is exact.

    Raises `InputError` if the problem takes no account of such errors.
    """
    if not problem.is_uncertain:
        return points, None
    if not problem.takes_prior:
        told = "leave focal_noise and centre_noise out; only P3P and UP2P allow for them"
        raise InputError(f"camera: its calibration is not exact, which {problem.name} does not allow for; {told}")
    camera, axes = problem.camera, np.eye(3)  # type: ignore[attr-defined]
    if isinstance(problem, UP2P) and problem.vertical_noise == 0.0:
        axes = unit_direction(problem.vertical_camera, problem.name)[None]
    return add_calibration_noise(points, camera, axes)

"""Lens models: their interface and their common parts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from rootmatch.arrays import Bools, Floats
from rootmatch.errors import InputError

STEPS = 60
"""Maximum number of steps of a root finder: a bisection over the whole range of a double takes about as many."""


class Lens(ABC):
    """The image, in units of the focal length about the principal point, of directions of the camera frame."""

    @property
    @abstractmethod
    def radius(self) -> float:
        """Distance from the principal point, in focal lengths, where the model folds over; infinite if nowhere."""

    @abstractmethod
    def image(self, points: Floats) -> Floats:
        """Image (…, 2) of points (…, 3)."""

    @abstractmethod
    def jacobian(self, points: Floats) -> Floats:
        """Derivatives (…, 2, 3) of the image by the points."""

    @abstractmethod
    def sees(self, points: Floats) -> Bools:
        """Whether points (…, 3) are on the near side of the fold."""

    @abstractmethod
    def rays(self, image: Floats) -> Floats:
        """Rays (…, 3) of an image (…, 2), of any length; NaN if the lens shows nothing."""


def coefficients(values: ArrayLike, counts: Sequence[int], name: str) -> tuple[float, ...]:
    """Distortion coefficients as a tuple."""
    expected = " or ".join([", ".join(map(str, counts[:-1])), str(counts[-1])] if len(counts) > 1 else [str(counts[0])])
    try:
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name}: not a list of numbers; give {expected} coefficients") from None
    if numbers.size != max(numbers.shape, default=0) or numbers.size not in counts:
        raise InputError(f"{name}: {numbers.size} coefficients of shape {numbers.shape} given; give {expected}")
    if not np.all(np.isfinite(numbers)):
        raise InputError(f"{name}: it holds NaN or infinity; give {expected} finite coefficients")
    if np.any(np.abs(numbers) > 1e12):
        raise InputError(
            f"{name}: {np.abs(numbers).max():g} given, which no lens has; give the calibrated coefficients"
        )
    return tuple(float(value) for value in numbers.ravel())


def first_positive_root(polynomial: Sequence[float] | Floats) -> float:
    """The least positive root of a polynomial, highest degree first, where it changes sign; infinite if none."""
    roots = np.roots(np.trim_zeros(np.asarray(polynomial, dtype=float), "f"))
    real = np.sort(roots.real[np.abs(roots.imag) <= 1e-9 * (1.0 + np.abs(roots))])
    for root in real[real > 0.0]:
        below, above = np.polyval(polynomial, root * (1.0 - 1e-6)), np.polyval(polynomial, root * (1.0 + 1e-6))
        if below * above <= 0.0:
            return float(root)
    return np.inf


def increasing_root(
    function: Callable[[Floats], tuple[Floats, Floats]], wanted: Floats, high: float, guess: Floats
) -> Floats:
    """Arguments at which a function that increases from 0 at 0 has the wanted values (m,): Newton's method in brackets.

    Parameters
    ----------
    function : callable
        Value and derivative (m,).
    wanted : (m,) array
        Not negative.
    high : float
        End of the interval, perhaps infinite; where the function does not get so far, ``high`` is returned.
    guess : (m,) array
    """
    low, upper = np.zeros_like(wanted), np.full_like(wanted, high)
    x = np.clip(guess, 0.0, 0.999 * high if np.isfinite(high) else None)
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            value, slope = function(x)
            low, upper = np.where(value <= wanted, x, low), np.where(value > wanted, x, upper)
            step = x - (value - wanted) / slope
            outside = ~((step >= low) & (step <= upper))
            new = step
            if outside.any():
                middle = np.where(np.isfinite(upper), 0.5 * (low + upper), 2.0 * low + 1.0)
                new = np.where(outside, middle, step)
            done = np.abs(new - x) <= 4e-16 * np.abs(x)
            x = new
            if done.all():
                break
    return x

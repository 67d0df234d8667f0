"""Closed-form roots against numpy.roots (companion matrix), random and near-degenerate; Horner against numpy.polyval.

Of an m-fold root floating point keeps about 16/m digits, whatever the method: the tolerances say which.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from rootmatch.algebra.polynomial import (
    curvature_quartic,
    largest_root_cubic,
    polish,
    roots_quadratic,
    roots_quartic,
    slope_quartic,
    value_quartic,
)

Maker = Callable[[np.random.Generator], np.ndarray]


def complex_roots(a: np.ndarray) -> np.ndarray:
    r0, r1, r2, r3, i01, i23 = roots_quartic(*a)
    return np.array([complex(r0, i01), complex(r1, -i01), complex(r2, i23), complex(r3, -i23)])


def distance(found: np.ndarray, wanted: np.ndarray) -> float:
    """Largest distance of the best of all pairings, relative to the size of the roots."""
    sizes = 1.0 + np.abs(wanted)
    pairings = itertools.permutations(range(len(wanted)))
    return min(float(np.max(np.abs(found[list(order)] - wanted) / sizes)) for order in pairings)


def relative_value(a: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.abs(np.polyval(a, x)) / np.polyval(np.abs(a), np.abs(x))


def repeated(times: int) -> Maker:
    return lambda rng: np.poly(np.concatenate((rng.normal(size=4 - times), np.full(times, rng.normal()))))


def cluster(times: int, width: float) -> Maker:
    return lambda rng: np.poly(
        np.concatenate((rng.normal(size=4 - times), rng.normal() + width * rng.normal(size=times)))
    )


def nearly_real(imaginary: float) -> Maker:
    def make(rng: np.random.Generator) -> np.ndarray:
        pair = rng.normal() + np.array([1j, -1j]) * imaginary
        return np.real(np.poly(np.concatenate((rng.normal(size=2), pair))))

    return make


def biquadratic(odd: float) -> Maker:
    return lambda rng: np.array([1.0, 0.0, rng.normal(), odd * rng.normal(), rng.normal()])


FAMILIES: dict[str, tuple[Maker, float]] = {
    "random coefficients": (lambda rng: rng.normal(size=5), 1e-6),
    "random real roots": (lambda rng: np.poly(rng.normal(size=4)), 1e-8),
    "roots about one": (lambda rng: np.poly(1.0 + 0.05 * rng.normal(size=4)), 3e-4),
    "small roots": (lambda rng: np.poly(0.05 * rng.normal(size=4)), 1e-9),
    "double root": (repeated(2), 1e-5),
    "triple root": (repeated(3), 1e-4),
    "fourfold root": (repeated(4), 1e-3),
    "two 1e-4 apart": (cluster(2, 1e-4), 1e-6),
    "three 1e-3 apart": (cluster(3, 1e-3), 1e-4),
    "complex pair, imaginary 1e-3": (nearly_real(1e-3), 1e-8),
    "complex pair, imaginary 1e-6": (nearly_real(1e-6), 1e-5),
    "no odd powers": (biquadratic(0.0), 1e-6),
    "nearly no odd powers": (biquadratic(1e-9), 1e-6),
}


class TestQuartic:
    @pytest.mark.parametrize("name", FAMILIES)
    def test_against_the_companion_matrix(self, name: str) -> None:
        make, tolerance = FAMILIES[name]
        rng = np.random.default_rng(0)
        distances = []
        for _ in range(200):
            a = make(rng) * rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-8.0, 8.0)
            found = complex_roots(a)
            assert np.isfinite(found).all()
            assert relative_value(a, found).max() < 1e-7
            distances.append(distance(found, np.roots(a)))
        assert max(distances) < tolerance

    def test_simple_real_roots_are_right_to_rounding(self) -> None:
        rng = np.random.default_rng(1)
        for _ in range(400):
            wanted = np.sort(rng.choice(np.arange(-20, 21), 4, replace=False) / 10.0)
            found = np.sort(np.array(roots_quartic(*np.poly(wanted))[:4]))
            np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-11)

    def test_the_real_part_of_a_pair_is_given_twice(self) -> None:
        """Noise of 1e-10 tears a double root at 0.7 into a pair 1e-5 off the line; its real part stays."""
        a = np.poly([0.7, 0.7, -1.2, 2.0]) + np.array([0.0, 0.0, 0.0, 0.0, -1e-10])
        assert np.abs(np.roots(a).imag).max() > 1e-6
        r = roots_quartic(*a)
        pair, other = (r[:2], r[2:4]) if r[4] > 0.0 else (r[2:4], r[:2])
        assert max(r[4], r[5]) == pytest.approx(np.abs(np.roots(a).imag).max(), rel=1e-4)
        assert min(r[4], r[5]) == 0.0
        assert pair[0] == pair[1] == pytest.approx(0.7, abs=1e-8)
        np.testing.assert_allclose(np.sort(other), [-1.2, 2.0], atol=1e-9)

    def test_a_large_spread_of_roots(self) -> None:
        """Each is right to 1e-6 of itself over three decades; beyond that the small ones lose digits."""
        rng = np.random.default_rng(2)
        for _ in range(400):
            wanted = np.sort(10.0 ** rng.uniform(-1.5, 1.5, 4) * rng.choice((-1.0, 1.0), 4))
            if np.diff(wanted).min() < 1e-3 * np.abs(wanted).max():
                continue
            found = np.sort(np.array(roots_quartic(*np.poly(wanted))[:4]))
            np.testing.assert_allclose(found, wanted, rtol=1e-6)


class TestSmallPieces:
    def test_horner(self) -> None:
        rng = np.random.default_rng(3)
        for _ in range(50):
            a, x = rng.normal(size=5), float(rng.normal())
            assert value_quartic(*a, x) == pytest.approx(np.polyval(a, x), rel=1e-12, abs=1e-12)
            assert slope_quartic(*a[:4], x) == pytest.approx(np.polyval(np.polyder(a), x), rel=1e-12, abs=1e-12)
            assert curvature_quartic(*a[:3], x) == pytest.approx(np.polyval(np.polyder(a, 2), x), rel=1e-12, abs=1e-12)

    def test_quadratic(self) -> None:
        rng = np.random.default_rng(4)
        for _ in range(400):
            a = rng.normal(size=3) * 10.0 ** rng.uniform(-6.0, 6.0, 3)
            r0, r1, imaginary = roots_quadratic(*a)
            wanted = np.roots(a)
            if imaginary > 0.0:
                assert r0 == r1
                np.testing.assert_allclose(r0, wanted[0].real, rtol=1e-9)
                np.testing.assert_allclose(imaginary, abs(wanted[0].imag), rtol=1e-9)
            else:
                np.testing.assert_allclose(np.sort([r0, r1]), np.sort(wanted), rtol=1e-9)

    def test_quadratic_without_cancellation(self) -> None:
        """1e-12 and 1e4: the textbook formula gives 0 for the lesser."""
        r0, r1, _ = roots_quadratic(1.0, -1e4, 1e-8)
        assert min(r0, r1) == pytest.approx(1e-12, rel=1e-12)

    def test_quadratic_without_its_leading_coefficient(self) -> None:
        r0, r1, imaginary = roots_quadratic(0.0, 2.0, -3.0)
        assert imaginary == 0.0
        assert sorted((abs(r0), abs(r1))) == [1.5, math.inf]
        assert min((r0, r1), key=abs) == 1.5

    def test_largest_root_of_a_cubic(self) -> None:
        rng = np.random.default_rng(5)
        for _ in range(400):
            a = np.concatenate(([1.0], rng.normal(size=3)))
            wanted = np.roots(a)
            largest = wanted[np.abs(wanted.imag) < 1e-9].real.max()
            assert largest_root_cubic(*a[1:]) == pytest.approx(largest, abs=1e-7)

    def test_a_newton_step_never_leaves_for_worse(self) -> None:
        """At an extremum Newton's step is wild; the estimate must stay."""
        a = np.poly([1.0, 1.0, -2.0, 3.0]) + np.array([0.0, 0.0, 0.0, 0.0, -1e-6])
        rng = np.random.default_rng(6)
        for x in 1.0 + 1e-5 * rng.normal(size=200):
            y = polish(*a, x)
            assert abs(np.polyval(a, y)) <= abs(np.polyval(a, x)) * (1.0 + 1e-9)
        assert polish(*np.poly([0.5, 2.0, 3.0, 4.0]), 0.500001) == pytest.approx(0.5, abs=1e-10)

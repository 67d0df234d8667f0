"""Roots and resultants of any degree against NumPy's companion matrix, QR factorisation and singular values."""

from __future__ import annotations

import numpy as np
import pytest

import oracles
from rootmatch.algebra.any_degree import make_root_kernel, make_singular_value_kernel
from rootmatch.algebra.bezout import make_last_entry_kernel, make_lesser_entry_kernel

DEGREES = (1, 5)  # two and four have tests of their own


def pairs(degree: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Random pairs, every second one with a common root up to 1e-6."""
    rng = np.random.default_rng(degree)
    made = []
    for k in range(40):
        p, q = rng.normal(size=(2, degree + 1))
        if k % 2:
            factor = [1.0, -rng.normal()]
            p = np.convolve(p[1:], factor)
            q = np.convolve(q[1:], factor) + 1e-6 * rng.normal(size=degree + 1)
        made.append((p, q))
    return made


@pytest.mark.parametrize("degree", DEGREES)
def test_last_entry_is_that_of_qr(degree: int) -> None:
    for p, q in pairs(degree):
        assert make_last_entry_kernel(degree)(*p, *q) == pytest.approx(oracles.qr(p, q), rel=1e-6)
        assert make_lesser_entry_kernel(degree)(*p, *q) == pytest.approx(oracles.qr_both(p, q), rel=1e-6)


@pytest.mark.parametrize("degree", DEGREES)
def test_singular_value(degree: int) -> None:
    for p, q in pairs(degree):
        assert make_singular_value_kernel(degree)(*p, *q) == pytest.approx(oracles.svd(p, q), rel=1e-6)


@pytest.mark.parametrize("degree", DEGREES)
def test_all_real_roots_and_the_real_part_of_others(degree: int) -> None:
    for p, _ in pairs(degree):
        for scale in (1.0, 1e-5):
            coefficients = p * np.concatenate(([scale], np.ones(degree)))  # a small leading end: a root far out
            found = np.array(make_root_kernel(degree)(*coefficients))
            expected = np.roots(coefficients)
            real = expected[np.abs(expected.imag) < 1e-9 * np.abs(expected)].real
            others = expected[np.abs(expected.imag) >= 1e-9 * np.abs(expected)].real
            assert len(found) == degree
            for root in (*real, *others):
                assert np.min(np.abs(found - root)) < 1e-6 * (1.0 + abs(root))


@pytest.mark.parametrize("degree", DEGREES)
def test_a_zero_polynomial_says_nothing(degree: int) -> None:
    p, zero = np.ones(degree + 1), np.zeros(degree + 1)
    for kernel in (make_last_entry_kernel, make_lesser_entry_kernel, make_singular_value_kernel):
        assert kernel(degree)(*p, *zero) >= 1.4
        assert np.isfinite(kernel(degree)(*zero, *p))

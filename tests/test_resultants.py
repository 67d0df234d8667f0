"""Closed forms of |R| and the least singular value against QR, SVD and exact fractions.

The Sylvester matrix is written out again here. Where closed form and factorisation part in float64 is measured against
rational arithmetic, which has no rounding: `TestWhereTheyPart`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from rootmatch.algebra.any_degree import NO_INFORMATION
from rootmatch.algebra.bezout import make_last_entry_kernel, make_lesser_entry_kernel
from rootmatch.algebra.sylvester import (
    smallest_singular_value_quadratic,
    smallest_singular_value_quartic,
    sylvester_matrix,
)

Pair = tuple[np.ndarray, np.ndarray]
UNIT = {degree: make_last_entry_kernel(degree) for degree in (4, 2)}
LESSER = {degree: make_lesser_entry_kernel(degree) for degree in (4, 2)}
ABOUT_ONE, LESSER_ABOUT_ONE = (make(4, about_one=True) for make in (make_last_entry_kernel, make_lesser_entry_kernel))
MINIMUM = {4: smallest_singular_value_quartic, 2: smallest_singular_value_quadratic}


def sylvester(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """x^m p(x) and x^m q(x) for m = k - 1 ... 0, as rows of coefficients."""
    k = len(p) - 1
    rows = []
    for polynomial in (p, q):
        for m in range(k - 1, -1, -1):
            row = np.zeros(2 * k)
            for power, coefficient in enumerate(polynomial[::-1]):
                row[2 * k - 1 - (power + m)] = coefficient
            rows.append(row)
    return np.array(rows)


def by_qr(p: np.ndarray, q: np.ndarray) -> float:
    return float(abs(np.linalg.qr(sylvester(p, q), mode="r")[-1, -1]))


def by_svd(p: np.ndarray, q: np.ndarray) -> float:
    return float(np.linalg.svd(sylvester(p, q), compute_uv=False)[-1])


def last_row_of_inverse(matrix: list[list[Fraction]]) -> list[Fraction]:
    """x with Mᵀ x = e_n, by Gauss elimination without rounding."""
    n = len(matrix)
    system = [[matrix[i][j] for i in range(n)] + [Fraction(int(j == n - 1))] for j in range(n)]
    for column in range(n):
        pivot = next(r for r in range(column, n) if system[r][column] != 0)
        system[column], system[pivot] = system[pivot], system[column]
        for r in range(n):
            if r != column and system[r][column] != 0:
                factor = system[r][column] / system[column][column]
                system[r] = [a - factor * b for a, b in zip(system[r], system[column], strict=True)]
    return [system[k][n] / system[k][k] for k in range(n)]


def by_fractions(p: np.ndarray, q: np.ndarray) -> float:
    """1 / |last row of the inverse|."""
    x = last_row_of_inverse([[Fraction(float(v)) for v in row] for row in sylvester(p, q)])
    return 1.0 / math.sqrt(sum(v * v for v in x))


def unit(p: np.ndarray) -> np.ndarray:
    return p / np.sqrt((p * p).sum())


def random_pair(rng: np.random.Generator, k: int) -> Pair:
    return rng.normal(size=k + 1), rng.normal(size=k + 1)


def near_common_root(rng: np.random.Generator, k: int) -> Pair:
    x, gap = rng.normal(), 10.0 ** rng.uniform(-12.0, -3.0)
    return np.polymul([1.0, -x], rng.normal(size=k)), np.polymul([1.0, -x - gap], rng.normal(size=k))


def about_one(rng: np.random.Generator, k: int) -> Pair:
    return np.poly(1.0 + 0.1 * rng.normal(size=k)), np.poly(1.0 + 0.1 * rng.normal(size=k))


def one_leading_zero(rng: np.random.Generator, k: int) -> Pair:
    p, q = random_pair(rng, k)
    p[0] = 0.0
    return p, q


def both_leading_small(rng: np.random.Generator, k: int) -> Pair:
    p, q = random_pair(rng, k)
    p[0], q[0] = 1e-9 * rng.normal(size=2)
    return p, q


def both_last_zero(rng: np.random.Generator, k: int) -> Pair:
    p, q = random_pair(rng, k)
    p[-1] = q[-1] = 0.0
    return p, q


FAMILIES: list[Callable[[np.random.Generator, int], Pair]] = [
    random_pair,
    near_common_root,
    about_one,
    one_leading_zero,
    both_leading_small,
    both_last_zero,
]


def pairs(family: Callable[[np.random.Generator, int], Pair], degree: int, count: int = 300) -> list[Pair]:
    rng = np.random.default_rng(degree)
    return [family(rng, degree) for _ in range(count)]


@pytest.mark.parametrize("degree", [4, 2])
class TestAgainstFactorisations:
    def tolerance(self, family: Callable[..., Pair], degree: int) -> float:
        """What the cofactors of roots within 0.1 of each other cancel to, or rounding: see TestWhereTheyPart."""
        return 2e-9 if family is about_one and degree == 4 else 1e-12

    @pytest.mark.parametrize("family", FAMILIES)
    def test_last_entry_of_unit_polynomials(self, family: Callable[..., Pair], degree: int) -> None:
        for p, q in pairs(family, degree):
            wanted = by_qr(unit(p), unit(q))
            assert UNIT[degree](*p, *q) == pytest.approx(wanted, rel=1e-8, abs=self.tolerance(family, degree))

    @pytest.mark.parametrize("family", FAMILIES)
    def test_lesser_of_both_orders(self, family: Callable[..., Pair], degree: int) -> None:
        for p, q in pairs(family, degree):
            wanted = min(by_qr(unit(p), unit(q)), by_qr(unit(p)[::-1], unit(q)[::-1]))
            assert LESSER[degree](*p, *q) == pytest.approx(wanted, rel=1e-8, abs=self.tolerance(family, degree))

    @pytest.mark.parametrize("family", FAMILIES)
    def test_least_singular_value(self, family: Callable[..., Pair], degree: int) -> None:
        for p, q in pairs(family, degree):
            scale = max(np.linalg.norm(p), np.linalg.norm(q))
            assert MINIMUM[degree](*p, *q) == pytest.approx(by_svd(p, q), rel=1e-12, abs=3e-15 * scale)

    def test_the_lesser_stays_near_the_least_singular_value(self, degree: int) -> None:
        """At a common root |R| = σ ‖y‖ / |y_last|, and one of the two orders has |y_last| as its largest entry."""
        rng = np.random.default_rng(3)
        one = []
        for _ in range(300):
            x = 10.0 ** rng.uniform(-1.5, 1.5)
            p = unit(np.polymul([1.0, -x], rng.normal(size=degree)))
            q = unit(np.polymul([1.0, -x * (1.0 + 1e-6)], rng.normal(size=degree)))
            minimum = by_svd(p, q)
            assert LESSER[degree](*p, *q) < 1.01 * math.sqrt(2 * degree) * minimum
            one.append(UNIT[degree](*p, *q) / minimum)
        assert max(one) > 30.0

    def test_nothing_known_is_not_agreement(self, degree: int) -> None:
        """A zero polynomial gets more than any pair can reach; |R| of a unit pair is at most √2."""
        rng = np.random.default_rng(6)
        zero, p = np.zeros(degree + 1), rng.normal(size=degree + 1)
        for first, second in ((zero, p), (p, zero), (zero, zero)):
            assert UNIT[degree](*first, *second) == NO_INFORMATION > math.sqrt(2.0)
            assert LESSER[degree](*first, *second) == NO_INFORMATION
            assert MINIMUM[degree](*first, *second) == pytest.approx(0.0, abs=1e-15)

    def test_a_common_root_at_infinity(self, degree: int) -> None:
        """Both leading coefficients 0: the closed form sees the common root as σ_min does; QR finds its 0 earlier."""
        rng = np.random.default_rng(7)
        p, q = rng.normal(size=(2, degree + 1))
        p[0] = q[0] = 0.0
        assert UNIT[degree](*p, *q) == 0.0
        assert LESSER[degree](*p, *q) == 0.0
        assert MINIMUM[degree](*p, *q) == pytest.approx(0.0, abs=1e-15)

    def test_proportional_polynomials_agree(self, degree: int) -> None:
        p = np.arange(1.0, degree + 2.0)
        assert UNIT[degree](*p, *(-2.0 * p)) == pytest.approx(0.0, abs=1e-15)
        assert LESSER[degree](*p, *p) == pytest.approx(0.0, abs=1e-15)


class TestSylvesterMatrix:
    @pytest.mark.parametrize("degree", [1, 2, 3, 4, 7])
    def test_any_degree_in_batches(self, degree: int) -> None:
        rng = np.random.default_rng(degree)
        p, q = rng.normal(size=(2, 3, 5, degree + 1))
        made = sylvester_matrix(p, q)
        assert made.shape == (3, 5, 2 * degree, 2 * degree)
        for k in np.ndindex(3, 5):
            np.testing.assert_array_equal(made[k], sylvester(p[k], q[k]))

    def test_one_against_many(self) -> None:
        rng = np.random.default_rng(1)
        p, q = rng.normal(size=5), rng.normal(size=(6, 5))
        np.testing.assert_array_equal(sylvester_matrix(p, q)[2], sylvester(p, q[2]))

    def test_powers_of_a_common_root_are_its_null_vector(self) -> None:
        p, q = np.polymul([1.0, -1.5], [2.0, 1.0]), np.polymul([1.0, -1.5], [1.0, 3.0])
        np.testing.assert_allclose(sylvester_matrix(p, q) @ 1.5 ** np.arange(3, -1, -1), 0.0, atol=1e-14)


def crowded(rng: np.random.Generator, gap: float) -> tuple[Pair, Pair]:
    """Two quartics in z = x − 1 with roots of size 0.05, one common up to the gap; and the same in x, rounded."""
    root = 0.05 * rng.normal()
    first = np.poly(np.concatenate(([root], 0.05 * rng.normal(size=3))))
    second = np.poly(np.concatenate(([root + gap], 0.05 * rng.normal(size=3))))
    powers = [np.poly(np.ones(m)) for m in range(5)]  # (x − 1)^m
    in_x = []
    for shifted in (first, second):
        total = np.zeros(5)
        for m, coefficient in enumerate(shifted[::-1]):
            total[4 - m :] += coefficient * powers[m]
        in_x.append(total)
    return (first, second), (in_x[0], in_x[1])


def exact_in_x(shifted: Pair) -> float:
    """|R| of the unit quartics in x of two given in x − 1, with the shift and the elimination in fractions."""
    rows = []
    for coefficients in shifted:
        total = [Fraction(0)] * 5
        for m, value in enumerate(coefficients[::-1]):
            for power in range(m + 1):
                total[power] += Fraction(float(value)) * math.comb(m, power) * (-1) ** (m - power)
        rows.append(total[::-1])
    n = 8
    matrix = [[Fraction(0)] * n for _ in range(n)]
    for k, row in enumerate(rows):
        for m in range(4):
            matrix[4 * k + m][m : m + 5] = row
    x = last_row_of_inverse(matrix)
    # x belongs to the quartics as given; scaling one by 1/norm scales its half of the row by the norm
    norms = [sum(v * v for v in row) for row in rows]
    return 1.0 / math.sqrt(norms[0] * sum(v * v for v in x[:4]) + norms[1] * sum(v * v for v in x[4:]))


class TestWhereTheyPart:
    """Errors against rational arithmetic, which the docstrings of `rootmatch.algebra.bezout` state."""

    def test_ordinary_quartics_closed_form_no_worse_than_qr(self) -> None:
        rng = np.random.default_rng(0)
        closed, factored = [], []
        for _ in range(60):
            p, q = (unit(v) for v in near_common_root(rng, 4))
            exact = by_fractions(p, q)
            closed.append(abs(UNIT[4](*p, *q) - exact))
            factored.append(abs(by_qr(p, q) - exact))
        assert np.median(closed) <= np.median(factored) < 1e-16
        assert max(closed) < 1e-13
        assert max(factored) < 1e-13

    @pytest.mark.parametrize("gap", [1e-2, 1e-5])
    def test_roots_crowded_about_one(self, gap: float) -> None:
        """From coefficients in x the closed form is off by 1e-11 (worst 2e-8); about x = 1 it beats QR by far."""
        rng = np.random.default_rng(1)
        errors = {"x": [], "QR": [], "about one": [], "relative": []}  # type: dict[str, list[float]]
        for _ in range(40):
            shifted, in_x = crowded(rng, gap)
            exact = exact_in_x(shifted)
            errors["x"].append(abs(UNIT[4](*in_x[0], *in_x[1]) - exact))
            errors["QR"].append(abs(by_qr(unit(in_x[0]), unit(in_x[1])) - exact))
            about = ABOUT_ONE(*shifted[0], *shifted[1])
            errors["about one"].append(abs(about - exact))
            errors["relative"].append(abs(about / exact - 1.0))
        assert max(errors["QR"]) < 2e-15
        assert 1e-13 < np.median(errors["x"]) < 1e-9
        assert max(errors["x"]) < 1e-6
        assert max(errors["about one"]) < 1e-20
        assert np.median(errors["relative"]) < 1e-10

    def test_the_lesser_about_one(self) -> None:
        rng = np.random.default_rng(2)
        for _ in range(100):
            shifted, in_x = crowded(rng, 1e-2)
            p, q = unit(in_x[0]), unit(in_x[1])
            wanted = min(by_qr(p, q), by_qr(p[::-1], q[::-1]))
            value = LESSER_ABOUT_ONE(*shifted[0], *shifted[1])
            assert value == pytest.approx(wanted, rel=1e-6, abs=3e-15)

    def test_least_singular_value_of_nearly_dependent_rows(self) -> None:
        """Where both end: the value is rounding below 1e-15, in either."""
        rng = np.random.default_rng(3)
        for gap in 10.0 ** np.arange(-16.0, 0.0):
            p, q = np.poly([0.9, 1.1, -2.0, 0.5]), np.poly([0.9 + gap, 1.4, 3.0, *rng.normal(size=1)])
            p, q = unit(p), unit(q)
            assert smallest_singular_value_quartic(*p, *q) == pytest.approx(by_svd(p, q), rel=1e-9, abs=1e-15)

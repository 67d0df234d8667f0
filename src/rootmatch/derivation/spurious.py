"""Spurious factors and vanishing coefficients, which elimination adds to a polynomial.

Two kinds are found. A factor that is the same for all measurements, such as the 1 + x² that clears the denominators of
a rotation: its roots are roots of the polynomial of *any* measurements, so a few random draws show them; names hide the
relations that a symbolic factorisation would need. And factors that are visible among the leaves, among them repeated
ones: they are tried symbolically where the polynomial is short enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp

from rootmatch.arrays import Floats
from rootmatch.derivation.elimination import Definitions, horner
from rootmatch.derivation.leaves import Expr, Leaves
from rootmatch.derivation.straight_line import Program, function_text
from rootmatch.errors import InputError
from rootmatch.problems.derived.store import compile_vetted

DRAWS = 8
"""Random measurements by which factors are found."""
ZERO = 1e-9
"""Relative value below which a coefficient, or the polynomial at a root of it, is taken to vanish."""
FACTOR_TERMS = 400
"""Terms up to which a symbolic factorisation is tried; it takes a second then."""


def random_coefficients(
    leaves: Leaves, definitions: dict[Expr, Expr], coefficients: Sequence[Expr], rng: np.random.Generator
) -> Floats:
    """Coefficients (DRAWS, k + 1) at random measurements, each row of unit norm."""
    program = Program(definitions)
    inputs = sorted(set().union(*(program.inputs(c) for c in coefficients)), key=str)
    text = function_text("polynomial", inputs, list(coefficients), program, "")
    function = compile_vetted("plan = {}\n" + text).functions["polynomial"]
    values: dict[Expr, Floats] = {}
    for side, what in (("s", leaves.source), ("t", leaves.target)):
        for slot in range(leaves.minimal):
            measured = what.measure(what.sample(rng, DRAWS))
            # what is the same for all points of one draw (an axis) must be so here too
            values |= dict(zip(leaves.points[side][slot], measured.T, strict=True))
    numbers = [_evaluate_expression(leaves.raw[symbol], values) for symbol in inputs]
    with np.errstate(all="ignore"):
        rows = np.array(np.broadcast_arrays(*function(*numbers), np.empty(DRAWS))[:-1], dtype=float).T
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    if not np.all(np.isfinite(rows)) or np.any(norms == 0.0):
        raise InputError("elimination: the polynomial vanishes for all measurements; the equations are dependent")
    unit: Floats = rows / norms
    return unit


def _evaluate_expression(expression: Expr, values: dict[Expr, Floats]) -> Floats:
    symbols = sorted(expression.free_symbols, key=str)
    return np.asarray(sp.lambdify(symbols, expression, "numpy")(*(values[s] for s in symbols)))


def constant_roots(rows: Floats) -> list[complex]:
    """Roots that all rows share; a repeated one comes inaccurate, and once from the derivative where it is simple."""
    common = []
    derivative = rows[0]
    while len(derivative) > 1:
        for root in np.roots(derivative):
            powers = root ** np.arange(rows.shape[1] - 1, -1, -1)
            if np.all(np.abs(rows @ powers) <= ZERO * (np.abs(rows) @ np.abs(powers))):
                common.append(complex(root))
        derivative = np.polyder(derivative)
    return common


def constant_factor(roots: Sequence[complex]) -> list[Fraction] | None:
    """Coefficients, highest first, of one polynomial over the rationals with some of these roots; None if none is."""
    for root in roots:
        monic = [1.0, -root.real] if abs(root.imag) < 1e-7 else [1.0, -2.0 * root.real, abs(root) ** 2]
        exact = [Fraction(c).limit_denominator(64) for c in monic]
        if all(abs(float(e) - c) < 1e-6 for e, c in zip(exact, monic, strict=True)):
            return exact
    return None


def divide_polynomial(coefficients: Sequence[Expr], factor: Sequence[Fraction], name: Any) -> list[Expr]:
    """Quotient of Σ c_k x^k (highest first) by a factor with leading coefficient 1; the remainder is known to vanish.

    The upper half comes from the top and the lower half from the bottom, which keeps the sums short.
    """
    degree = len(coefficients) - len(factor)
    numbers = [sp.Rational(f.numerator, f.denominator) for f in factor]
    top: list[Expr] = []
    for k in range(degree + 1):
        value = coefficients[k]
        for j in range(1, min(k, len(factor) - 1) + 1):
            value -= numbers[j] * top[k - j]
        top.append(name(value))
    if numbers[-1] == 0:
        return top
    bottom: list[Expr] = []
    for k in range(degree + 1):
        value = coefficients[-1 - k]
        for j in range(1, min(k, len(factor) - 1) + 1):
            value -= numbers[-1 - j] * bottom[k - j]
        bottom.append(name(value / numbers[-1]))
    half = (degree + 1) // 2
    return top[: degree + 1 - half] + bottom[:half][::-1]


def remove_spurious(
    polynomials: Sequence[Any], x: Expr, definitions: Definitions, rng: np.random.Generator
) -> tuple[list[Expr], Expr, list[str]]:
    """Coefficients and value of the polynomial of least degree, cleaned, and what was taken off.

    Returns
    -------
    coefficients : list
        Highest degree first.
    value : expression
        The polynomial at x, up to a factor without real roots.
    removed : list of str
        Factors, for the report.
    """
    leaves = definitions.leaves
    polynomial = min(polynomials, key=lambda p: p.degree())
    removed: list[str] = []
    polynomial, visible = _visible_factors(polynomial, x, definitions)
    removed += visible
    value = definitions.values.get(polynomial.as_expr())
    coefficients = list(polynomial.all_coeffs())
    while True:
        rows = random_coefficients(leaves, definitions.entries, coefficients, rng)
        kept = np.abs(rows).max(axis=0) > ZERO
        first = int(np.argmax(kept))
        coefficients = [c if keep else sp.Integer(0) for c, keep in zip(coefficients, kept, strict=True)][first:]
        rows = rows[:, first:]
        factor = constant_factor(constant_roots(rows)) if len(coefficients) > 1 else None
        if factor is None:
            break
        expression = sp.expand(horner([sp.Rational(number.numerator, number.denominator) for number in factor], x))
        removed.append(str(expression))
        coefficients = divide_polynomial(coefficients, factor, definitions.name)
        value = value / expression if value is not None and _with_positive_sign(factor) else None
    if len(coefficients) < 2:
        raise InputError(
            "elimination: the shared variable drops out of the result; it is not determined by a minimal set"
        )
    return coefficients, horner(coefficients, x) if value is None else value, removed


def _with_positive_sign(factor: Sequence[Fraction]) -> bool:
    return len(factor) == 3 and factor[1] ** 2 < 4 * factor[2]


def _visible_factors(polynomial: Any, x: Expr, definitions: Definitions) -> tuple[Any, list[str]]:
    """The polynomial without content in the leaves and without repeated factors, as far as these can be seen."""
    terms = sum(len(sp.Add.make_args(c)) for c in polynomial.all_coeffs())
    if terms > FACTOR_TERMS or polynomial.as_expr() in definitions.values:
        return polynomial, []
    _, factors = sp.factor_list(polynomial.as_expr())
    kept, removed = sp.Integer(1), []
    for factor, power in factors:
        if x not in factor.free_symbols or not (factor.free_symbols - {x}):
            removed.append(f"{factor}^{power}")
            continue
        if power > 1:
            removed.append(f"{factor}^{power - 1}")
        kept *= factor
    if not removed:
        return polynomial, []
    return sp.Poly(sp.expand(kept), x), [text if len(text) < 60 else text[:57] + "..." for text in removed]

"""Elimination: one polynomial in the shared variable from a system, by substitution, determinants and resultants.

Every step is exact over the leaves. Long coefficients get a name (a *definition*) before a step that would multiply
them out; the generated code then computes them once, and elimination never sees more terms than it must.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import gcd
from typing import Any

import sympy as sp

from rootmatch.derivation.determinants import determinant, order_last_first, resultant, split_by_powers
from rootmatch.derivation.leaves import Expr, Leaves
from rootmatch.errors import InputError

TERMS = 20_000
"""Terms of one polynomial beyond which elimination gives up: generated code would take minutes to compile."""
SHORT = 2
"""Terms beyond which a coefficient gets a name."""


@dataclass
class Definitions:
    """Named coefficients, in an order in which each needs only earlier ones and leaves."""

    leaves: Leaves
    entries: dict[Expr, Expr] = field(default_factory=dict)
    values: dict[Any, Expr] = field(default_factory=dict)
    """Shorter expressions of the values of some polynomials in the shared variable."""
    _names: dict[Expr, Expr] = field(default_factory=dict)

    def name(self, expression: Expr) -> Expr:
        """A symbol for an expression in leaves and definitions, or a leaf where a table can hold it."""
        content, rest = expression.as_content_primitive()
        if rest.could_extract_minus_sign():
            content, rest = -content, -rest
        if not rest.is_Add:
            return expression
        if rest.free_symbols <= self.leaves.uses.keys() and self.leaves.can_be_tabulated(rest):
            return content * self.leaves.leaf(rest)
        if rest not in self._names:
            symbol = sp.Symbol(f"d{len(self._names)}", real=True)
            self._names[rest] = symbol
            self.entries[symbol] = rest
            self.leaves.named[symbol] = rest
        return content * self._names[rest]

    def shorten(self, polynomial: Any, minimum: int = SHORT) -> Any:
        """The polynomial with named coefficients wherever one has at least so many terms."""
        generators = polynomial.gens
        terms = {
            powers: self.name(coefficient) if len(sp.Add.make_args(coefficient)) >= minimum else coefficient
            for powers, coefficient in zip(polynomial.monoms(), polynomial.coeffs(), strict=True)
        }
        return sp.Poly.from_dict(terms, *generators)


def make_polynomials(equations: Sequence[Expr], generators: Sequence[Expr]) -> list[Any]:
    """Equations as polynomials in the unknowns, denominators cleared, zeros dropped."""
    out = []
    for equation in equations:
        numerator = sp.fraction(sp.together(equation))[0]
        try:
            polynomial = sp.Poly(numerator, *generators)
        except sp.PolynomialError:
            raise InputError(
                f"equations: {equation} is no polynomial in {', '.join(map(str, generators))}; write sines and cosines "
                "in x = tan(θ/2), and roots as unknowns of their own"
            ) from None
        if any(coefficient.free_symbols & set(generators) for coefficient in polynomial.coeffs()):
            raise InputError(f"equations: {equation} is no polynomial in {', '.join(map(str, generators))}")
        if not polynomial.is_zero:
            out.append(_divide_by_monomial(polynomial))
    return out


def eliminate(
    polynomials: list[Any], unknowns: Sequence[Expr], kept: Sequence[Expr], definitions: Definitions
) -> list[Any]:
    """Polynomials in the kept variables alone, which vanish where the system has a solution.

    Parameters
    ----------
    polynomials : list of sympy.Poly
        In all of ``unknowns`` and ``kept``.
    unknowns, kept : sequences of symbols
    definitions : Definitions
        Receives the names that are given on the way.
    """
    unknowns = [symbol for symbol in unknowns if any(_contains_symbol(p, symbol) for p in polynomials)]
    while unknowns:
        polynomials = [p for p in polynomials if not p.is_zero]
        polynomials = _replace_even_powers(polynomials, unknowns)
        step = _substitute_linear(polynomials, unknowns) or _eliminate_block(polynomials, unknowns, kept, definitions)
        if step is None:
            step = _eliminate_by_resultants(polynomials, unknowns, definitions)
        polynomials, gone = step
        polynomials = [_divide_by_monomial(p) for p in polynomials if not p.is_zero]
        unknowns = [
            symbol
            for symbol in unknowns
            if symbol not in gone and any(_contains_symbol(p, symbol) for p in polynomials)
        ]
        if max((len(_expanded_terms(p)) for p in polynomials), default=0) > TERMS:
            raise InputError(f"elimination: over {TERMS} terms; state fewer unknowns, or eliminate the easy ones first")
    kept_set = set(kept)
    rest = [p for p in polynomials if not p.is_zero and kept_set & p.free_symbols]
    if not rest:
        raise InputError(
            "elimination: nothing is left to determine the shared variable; give as many independent equations as "
            "unknowns, the shared one included (one fewer if all equations are homogeneous in some of them)"
        )
    return [sp.Poly(p.as_expr(), *kept) for p in rest]


def _contains_symbol(polynomial: Any, symbol: Expr) -> bool:
    return symbol in polynomial.gens and polynomial.degree(symbol) > 0


def _expanded_terms(polynomial: Any) -> list[Expr]:
    return [term for coefficient in polynomial.coeffs() for term in sp.Add.make_args(coefficient)]


def _divide_by_monomial(polynomial: Any) -> Any:
    """Divided by the greatest monomial in the unknowns: a solution with an unknown at 0 is not wanted."""
    if polynomial.is_zero:
        return polynomial
    lowest = [min(powers) for powers in zip(*polynomial.monoms(), strict=True)]
    terms = {
        tuple(p - minimum for p, minimum in zip(powers, lowest, strict=True)): coefficient
        for powers, coefficient in polynomial.terms()
    }
    return sp.Poly.from_dict(terms, *polynomial.gens)


def _replace_even_powers(polynomials: list[Any], unknowns: list[Expr]) -> list[Any]:
    """An unknown that occurs in even powers only is replaced by its square, and so on."""
    for symbol in unknowns:
        exponents = [powers[p.gens.index(symbol)] for p in polynomials for powers in p.monoms()]
        step = gcd(*exponents)
        if step > 1:
            changed = []
            for p in polynomials:
                place = p.gens.index(symbol)
                terms = {
                    (*powers[:place], powers[place] // step, *powers[place + 1 :]): coefficient
                    for powers, coefficient in p.terms()
                }
                changed.append(sp.Poly.from_dict(terms, *p.gens))
            polynomials = changed
    return polynomials


def _substitute_linear(polynomials: list[Any], unknowns: list[Expr]) -> tuple[list[Any], list[Expr]] | None:
    """An unknown that one equation gives without dividing by anything is put into the others."""
    for p in polynomials:
        for symbol in unknowns:
            if p.degree(symbol) != 1:
                continue
            slope = p.diff(symbol)
            if slope.is_ground and slope.as_expr().is_number:
                value = sp.Poly(symbol, *p.gens) - p.mul_ground(1 / slope.as_expr())
                rest = [_insert_polynomial(q, symbol, value) for q in polynomials if q is not p]
                return rest, [symbol]
    return None


def _insert_polynomial(polynomial: Any, symbol: Expr, value: Any) -> Any:
    """The polynomial with a polynomial put for one unknown, by Horner's rule."""
    total = sp.Poly(0, *polynomial.gens)
    for part in reversed(split_by_powers(polynomial, symbol, polynomial.degree(symbol))):
        total = total * value + part
    return total


def _eliminate_block(
    polynomials: list[Any], unknowns: list[Expr], kept: Sequence[Expr], definitions: Definitions
) -> tuple[list[Any], list[Expr]] | None:
    """Unknowns in which some equations are linear together: what is left is a determinant."""
    for size in range(len(unknowns), 0, -1):
        for block in combinations(unknowns, size):
            rows = [p for p in polynomials if any(_contains_symbol(p, symbol) for symbol in block)]
            if not all(_is_linear(p, block) for p in rows):
                continue
            homogeneous = all(_constant_part(p, block).is_zero for p in rows)
            needed = size + (0 if homogeneous else 1)
            others = [p for p in polynomials if not any(_contains_symbol(p, symbol) for symbol in block)]
            remaining = [symbol for symbol in unknowns if symbol not in block]
            wanted = max(1, len(remaining) + len(kept) - len(others))
            choices = list(combinations(rows, needed))[:wanted] if len(rows) >= needed else []
            if not choices or len(choices) < wanted:
                continue
            made = [_determinant(choice, block, homogeneous, definitions) for choice in choices]
            if any(d.is_zero for d in made):
                continue
            return [*others, *made], list(block)
    return None


def _is_linear(polynomial: Any, block: Sequence[Expr]) -> bool:
    places = [polynomial.gens.index(symbol) for symbol in block]
    return all(sum(powers[place] for place in places) <= 1 for powers in polynomial.monoms())


def _constant_part(polynomial: Any, block: Sequence[Expr]) -> Any:
    places = [polynomial.gens.index(symbol) for symbol in block]
    terms = {m: c for m, c in polynomial.terms() if not any(m[place] for place in places)}
    return sp.Poly.from_dict(terms or {(0,) * len(polynomial.gens): sp.Integer(0)}, *polynomial.gens)


def _determinant(rows: Sequence[Any], block: Sequence[Expr], homogeneous: bool, definitions: Definitions) -> Any:
    """Determinant of the coefficients of linear equations, by cofactors: sparse and without division.

    It is expanded along the row or column of the last correspondence, so that its minors are free of that one. Where
    the shared variable alone is left, the value at one x is kept beside the coefficients: it is shorter.
    """
    matrix = [
        [definitions.shorten(p.diff(symbol)) for symbol in block]
        + ([] if homogeneous else [definitions.shorten(_constant_part(p, block))])
        for p in rows
    ]
    matrix = order_last_first(matrix, definitions.leaves)
    polynomial = determinant(matrix, definitions.shorten)
    generators = [
        symbol for symbol in polynomial.gens if any(_contains_symbol(entry, symbol) for row in matrix for entry in row)
    ]
    if len(generators) == 1:
        x = generators[0]
        values = [[horner(sp.Poly(entry.as_expr(), x).all_coeffs(), x) for entry in row] for row in matrix]
        definitions.values[polynomial.as_expr()] = determinant(values, definitions.name)
    return polynomial


def horner(coefficients: Sequence[Expr], x: Expr) -> Expr:
    """Σ c_k x^k by Horner's rule, the highest power first."""
    total = sp.Integer(0)
    for coefficient in coefficients:
        total = total * x + coefficient
    return total


def _eliminate_by_resultants(
    polynomials: list[Any], unknowns: list[Expr], definitions: Definitions
) -> tuple[list[Any], list[Expr]]:
    """One unknown out by resultants of the equations that hold it with the simplest of them."""
    best: tuple[int, Expr, Any] | None = None
    for symbol in unknowns:
        holding = [p for p in polynomials if _contains_symbol(p, symbol)]
        if len(holding) < 2:
            continue
        pivot = min(holding, key=lambda p: (p.degree(symbol), len(p.terms())))
        cost = sum(pivot.degree(symbol) * p.degree(symbol) * len(p.terms()) for p in holding if p is not pivot)
        if best is None or cost < best[0]:
            best = cost, symbol, pivot
    if best is None:
        raise InputError(
            f"elimination: {', '.join(map(str, unknowns))} occur in one equation each, which adds nothing; "
            "leave such equations out"
        )
    _, symbol, pivot = best
    rest = [p for p in polynomials if not _contains_symbol(p, symbol)]
    shortened = definitions.shorten(pivot, 4)
    for p in polynomials:
        if p is not pivot and _contains_symbol(p, symbol):
            rest.append(resultant(shortened, definitions.shorten(p, 4), symbol))
    return rest, [symbol]

"""The parts of a polynomial that depend on the last target point, and those that can be computed before its loop.

A slab sweeps the last correspondence of a hyper-edge over all target points. So the polynomial of a minimal set with
that correspondence in its last slot is written as a polynomial in the few quantities that depend on the last target
point; its coefficients, and those of all its derivatives, are computed once for a whole row.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

from rootmatch.derivation.leaves import Expr, Leaves
from rootmatch.derivation.straight_line import Program

Split = dict[tuple[int, ...], Expr]
"""Powers of the last quantities to the coefficient that they multiply."""


@dataclass
class Hoisted:
    """The polynomial of a minimal set, split."""

    leaves: Leaves
    program: Program
    """Names that coefficients refer to."""
    last: list[Expr]
    """Leaves of the last target point."""
    monomials: list[tuple[int, ...]]
    """Powers of ``last``."""
    coefficients: list[Split]
    """Of each power of the shared variable, highest first."""
    value: list[Split]
    """Of the polynomial at one x, for each monomial: powers of ``row`` to their coefficients."""
    row: list[Expr]
    """Leaves of the last source point."""
    signs: list[list[Split]]
    """Of what must be positive, as ``value``."""

    def cost(self, dimensions: int) -> float:
        """Multiplications and loads of one step of the hot loop, roughly."""
        pairs = sum(len(self.leaves.uses[symbol].slots) == 2 for symbol in self.last)
        noise = self.leaves.target.noise_dimensions
        terms = len(self.monomials)
        return (
            terms * (2 + min(terms, dimensions)) + len(self.last) * terms * 0.5 + noise * (len(self.last) + 2 * pairs)
        )


def open_definitions(leaves: Leaves, definitions: dict[Expr, Expr]) -> dict[Expr, Expr]:
    """Definitions in which quantities of two target points are put in the coordinates of each."""
    entries: dict[Expr, Expr] = {}
    for symbol, use in list(leaves.uses.items()):
        if use.kind == "tt":
            raw = leaves.raw[symbol]
            entries[symbol] = raw.xreplace({part: leaves.leaf(part) for part in leaves.measured(raw)})
    return entries | definitions


def grading_key(powers: tuple[int, ...]) -> tuple[int, tuple[int, ...]]:
    """By which monomials are sorted: their degree, then their last powers."""
    return sum(powers), powers[::-1]


def hoist(
    leaves: Leaves, definitions: dict[Expr, Expr], coefficients: list[Expr], value: Expr, positive: list[Expr]
) -> Hoisted | None:
    """Split the coefficients (highest power first), the value at x and what must be positive there.

    None if they are not polynomial in quantities of the last target point.
    """
    program = Program(definitions)
    inputs: set[Expr] = set().union(*(program.inputs(c) for c in (*coefficients, value, *positive)))
    slot = leaves.minimal - 1
    swept = [symbol for symbol in sort_leaves(leaves, inputs) if slot in leaves.uses[symbol].slots]
    last = [symbol for symbol in swept if leaves.uses[symbol].kind[0] == "t"]
    try:
        by_last = _Splitter(program, last)
        splits = [by_last.nonzero(c) for c in coefficients]
        whole = by_last.nonzero(value)
        conditions = [by_last.nonzero(condition) for condition in positive]
    except _NotPolynomialError:
        return None
    found = {powers for one in (*splits, whole, *conditions) for powers in one}
    monomials = sorted(found, key=grading_key)
    row = [symbol for symbol in swept if symbol not in last]
    inner = [[one.get(powers, sp.Integer(0)) for powers in monomials] for one in (whole, *conditions)]
    try:
        by_row = _Splitter(program, row)
        parts = [[by_row.nonzero(part) for part in one] for one in inner]
    except _NotPolynomialError:
        row, parts = [], [[{(): part} if part != 0 else {} for part in one] for one in inner]
    return Hoisted(
        leaves=leaves,
        program=program,
        last=last,
        monomials=monomials,
        coefficients=splits,
        value=parts[0],
        row=row,
        signs=parts[1:],
    )


class _NotPolynomialError(Exception):
    """A quantity of the last point stands in a denominator or under a root."""


class _Splitter:
    """Writes expressions as polynomials in some symbols; what passes through a name keeps names for its parts."""

    def __init__(self, program: Program, symbols: list[Expr]) -> None:
        self.program = program
        self.symbols = symbols
        self.known: dict[Expr, Split] = {}
        self.one = (0,) * len(symbols)

    def nonzero(self, expression: Expr) -> Split:
        """The split without vanishing coefficients."""
        return {powers: value for powers, value in self.split(expression).items() if value != 0}

    def split(self, expression: Expr) -> Split:
        """Powers of the symbols to coefficients.

        Raises `_NotPolynomialError`.
        """
        if expression in self.known:
            return self.known[expression]
        if not (self.program.inputs(expression) & set(self.symbols)):
            return {self.one: expression}
        if expression in self.symbols:
            return {tuple(int(symbol == expression) for symbol in self.symbols): sp.Integer(1)}
        if expression in self.program.entries:
            inner = self.split(self.program.entries[expression])
            result = {powers: self.program.name(value) for powers, value in inner.items()}
            self.known[expression] = result
            return result
        if expression.is_Add:
            total: Split = {}
            for part in expression.args:
                for powers, value in self.split(part).items():
                    total[powers] = total.get(powers, sp.Integer(0)) + value
            return total
        if expression.is_Mul:
            result = {self.one: sp.Integer(1)}
            for part in expression.args:
                result = _product(result, self.split(part))
            return result
        if expression.is_Pow and expression.exp.is_Integer and int(expression.exp) > 0:
            base = self.split(expression.base)
            result = base
            for _ in range(int(expression.exp) - 1):
                result = _product(result, base)
            return result
        raise _NotPolynomialError


def _product(one: Split, other: Split) -> Split:
    total: Split = {}
    for powers, value in one.items():
        for more, factor in other.items():
            key = tuple(p + q for p, q in zip(powers, more, strict=True))
            total[key] = total.get(key, sp.Integer(0)) + value * factor
    return total


def sort_leaves(leaves: Leaves, symbols: set[Expr]) -> list[Expr]:
    """Leaf symbols in the order that generated functions take them."""

    def key(symbol: Expr) -> tuple[str, tuple[int, ...], int]:
        use = leaves.uses[symbol]
        return use.kind, use.slots, use.index

    return sorted((symbol for symbol in symbols if symbol in leaves.uses), key=key)

"""Determinants and resultants of polynomials with symbolic coefficients, without division."""

from __future__ import annotations

from typing import Any

import sympy as sp

from rootmatch.derivation.leaves import Expr, Leaves


def order_last_first(matrix: list[list[Any]], leaves: Leaves) -> list[list[Any]]:
    """The matrix, transposed and in another order so that what holds the last correspondence stands above."""

    def holds(entry: Any) -> bool:
        symbols = entry.as_expr().free_symbols
        found = {point for symbol in symbols for point in leaves.points_of(leaves.resolve_names(symbol))}
        return any(slot == leaves.minimal - 1 for _, slot in found)

    transposed = [list(column) for column in zip(*matrix, strict=True)]
    by_rows, by_columns = ([any(holds(e) for e in line) for line in m] for m in (matrix, transposed))
    if sum(by_columns) < sum(by_rows):
        matrix, by_rows = transposed, by_columns
    order = sorted(range(len(matrix)), key=lambda r: (not by_rows[r], -sum(entry == 0 for entry in matrix[r])))
    return [matrix[r] for r in order]


def determinant(matrix: list[list[Any]], name: Any) -> Any:
    """Determinant along the first row, then the next; each minor is computed once and passed through ``name``."""
    size = len(matrix)
    known: dict[tuple[int, tuple[int, ...]], Any] = {}

    def minor(row: int, columns: tuple[int, ...]) -> Any:
        if len(columns) == 1:
            return matrix[row][columns[0]]
        if (row, columns) not in known:
            total = None
            for place, column in enumerate(columns):
                if matrix[row][column] == 0:
                    continue
                rest = minor(row + 1, columns[:place] + columns[place + 1 :])
                term = matrix[row][column] * rest * (-1) ** place
                total = term if total is None else total + term
            total = matrix[0][0] * 0 if total is None else total
            known[row, columns] = total if row == 0 else name(total)
        return known[row, columns]

    return minor(0, tuple(range(size)))


def resultant(p: Any, q: Any, symbol: Expr) -> Any:
    """Resultant of two polynomials in one of their unknowns, as the determinant of their Bézout matrix.

    Degrees m ≥ n: where they differ, the Bézout matrix of p and q seen as of degree m holds the factor
    (leading coefficient of p)^(m−n), which is left out by using m − n rows of Sylvester's kind instead.
    """
    if p.degree(symbol) < q.degree(symbol):
        p, q = q, p
    m, n = p.degree(symbol), q.degree(symbol)
    a, b = split_by_powers(p, symbol, m), split_by_powers(q, symbol, m)
    zero = p * 0
    rows = []
    # the first n rows: Cayley's; the rest: shifts of q
    for r in range(n):
        row = []
        for c in range(m):
            total = zero
            for k in range(min(r, c) + 1):
                first, second = m - k, m - (r + c + 1 - k)
                if 0 <= second <= m:
                    total = (
                        total
                        + a[first] * _shifted_coefficient(b, n, m, second)
                        - _shifted_coefficient(b, n, m, first) * a[second]
                    )
            row.append(total)
        rows.append(row)
    for r in range(m - n):
        rows.append([b[n - (c - r)] if 0 <= c - r <= n else zero for c in range(m)])
    return determinant(rows, lambda minor: minor)


def _shifted_coefficient(b: list[Any], n: int, m: int, power: int) -> Any:
    """Coefficient of x^power in x^(m−n) q."""
    place = power - (m - n)
    return b[place] if 0 <= place <= n else b[0] * 0


def split_by_powers(polynomial: Any, symbol: Expr, degree: int) -> list[Any]:
    """Coefficients (lowest first, up to the degree) of the powers of one unknown, each a polynomial in the same."""
    place = polynomial.gens.index(symbol)
    parts: list[dict[tuple[int, ...], Expr]] = [{} for _ in range(degree + 1)]
    for powers, coefficient in polynomial.terms():
        parts[powers[place]][(*powers[:place], 0, *powers[place + 1 :])] = coefficient
    empty = {(0,) * len(polynomial.gens): sp.Integer(0)}
    return [sp.Poly.from_dict(part or empty, *polynomial.gens) for part in parts]

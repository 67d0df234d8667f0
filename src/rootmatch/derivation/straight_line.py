"""Straight-line programs: named expressions, their derivatives by the reverse mode, and their text as Python."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter
from sympy.simplify.cse_opts import sub_post, sub_pre

from rootmatch.derivation.leaves import Expr
from rootmatch.errors import InputError
from rootmatch.problems.derived.store import FUNCTIONS

WIDTH = 118
"""Width of a generated line, in characters."""


class Program:
    """Named expressions, each in inputs and earlier names.

    ``entries``: to begin with.
    """

    def __init__(self, entries: Mapping[Expr, Expr] | None = None) -> None:
        self.entries: dict[Expr, Expr] = dict(entries or {})
        self._known: dict[Expr, Expr] = {}
        self._count = 0

    def name(self, expression: Expr) -> Expr:
        """A symbol for an expression that is more than a symbol or a number."""
        number, rest = expression.as_coeff_Mul()
        if rest.is_Atom:
            return expression
        if rest not in self._known:
            symbol = sp.Symbol(f"h{self._count}", real=True)
            self._count += 1
            self.entries[symbol] = rest
            self._known[rest] = symbol
        return number * self._known[rest]

    def inputs(self, expression: Expr) -> set[Expr]:
        """The symbols that an expression depends on in the end."""
        found: set[Expr] = set()
        waiting = list(expression.free_symbols)
        seen: set[Expr] = set()
        while waiting:
            symbol = waiting.pop()
            if symbol in seen:
                continue
            seen.add(symbol)
            if symbol in self.entries:
                waiting.extend(self.entries[symbol].free_symbols)
            else:
                found.add(symbol)
        return found

    def gradient(self, expression: Expr, wanted: Sequence[Expr]) -> list[Expr]:
        """Derivatives of an expression in inputs, by the reverse mode; intermediate adjoints are named."""
        useful = {*wanted, *self.entries}
        adjoint = {symbol: sp.diff(expression, symbol) for symbol in expression.free_symbols & useful}
        for symbol in reversed(list(self.entries)):
            if symbol not in adjoint:
                continue
            outer = self.name(adjoint.pop(symbol))
            inner = self.entries[symbol]
            for part in inner.free_symbols & useful:
                adjoint[part] = adjoint.get(part, sp.Integer(0)) + outer * sp.diff(inner, part)
        return [adjoint.get(symbol, sp.Integer(0)) for symbol in wanted]


class _Printer(PythonCodePrinter):  # type: ignore[misc]
    """Floats for all numbers, products for powers, bare names for functions."""

    def _print_Rational(self, expr: Any) -> str:  # noqa: N802
        return repr(float(expr)) if expr >= 0 else f"({float(expr)!r})"

    _print_Integer = _print_Rational  # noqa: N815
    _print_Half = _print_Rational  # noqa: N815

    def _print_Float(self, expr: Any) -> str:  # noqa: N802
        return repr(float(expr))

    _print_NumberSymbol = _print_Pi = _print_Exp1 = _print_Float  # noqa: N815

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:  # noqa: N802
        base, power = expr.as_base_exp()
        text = self.parenthesize(base, 100)
        if power == sp.Rational(1, 2):
            return f"sqrt({self._print(base)})"
        if power == sp.Rational(-1, 2):
            return f"(1.0 / sqrt({self._print(base)}))"
        if power.is_Integer and 0 < int(power) <= 8:
            return "(" + " * ".join([text] * int(power)) + ")"
        if power.is_Integer and -8 <= int(power) < 0:
            return "(1.0 / (" + " * ".join([text] * -int(power)) + "))"
        raise InputError(f"equations: the power {expr} cannot be generated; write whole powers and square roots")

    def _print_Function(self, expr: Any) -> str:  # noqa: N802
        name = type(expr).__name__
        if name not in FUNCTIONS:
            raise InputError(f"equations: the function {name} cannot be generated; use {', '.join(FUNCTIONS)}")
        return f"{name}({', '.join(self._print(argument) for argument in expr.args)})"

    _print_sin = _print_cos = _print_tan = _print_exp = _print_log = _print_Function


_PRINTER = _Printer({"fully_qualified_modules": False})


def function_text(name: str, arguments: Sequence[Expr], outputs: Sequence[Expr], program: Program, summary: str) -> str:
    """Source of a function ``name(arguments) -> tuple of outputs`` with common subexpressions shared."""
    needed = _needed_entries(outputs, program)
    expressions = [*needed.values(), *outputs]
    # SymPy's "basic" optimisations without `factor_terms`, which takes a quarter of a derivation and saves nothing
    replacements, reduced = sp.cse(
        expressions, symbols=sp.numbered_symbols("e", real=True), optimizations=[(sub_pre, sub_post)]
    )
    assigned = dict(replacements) | dict(zip(needed, reduced[: len(needed)], strict=True))
    lines = [f"def {name}({', '.join(map(str, arguments))}):", f'    """{summary}"""']
    lines += [f"    {symbol} = {_PRINTER.doprint(value)}" for symbol, value in _sort_assignments(assigned)]
    results = ", ".join(_PRINTER.doprint(value) for value in reduced[len(needed) :])
    lines.append(f"    return ({results},)")
    return "\n".join(part for line in lines for part in _wrap_line(line)) + "\n"


def _wrap_line(line: str) -> list[str]:
    """A long line in pieces; inside brackets only, which a generated expression is given if it has none."""
    if len(line) <= WIDTH:
        return [line]
    head, equals, value = line.partition(" = ")
    if equals:
        line = f"{head} = ({value})"
    return textwrap.wrap(
        line, WIDTH, subsequent_indent=" " * 8, break_long_words=False, break_on_hyphens=False, drop_whitespace=True
    )


def _needed_entries(outputs: Iterable[Expr], program: Program) -> dict[Expr, Expr]:
    waiting = {symbol for output in outputs for symbol in output.free_symbols}
    found: dict[Expr, Expr] = {}
    for symbol in reversed(list(program.entries)):
        if symbol in waiting:
            found[symbol] = program.entries[symbol]
            waiting |= program.entries[symbol].free_symbols
    return dict(reversed(list(found.items())))


def _sort_assignments(assigned: Mapping[Expr, Expr]) -> list[tuple[Expr, Expr]]:
    """Assignments in an order in which each needs only earlier ones (depth first, without recursion)."""
    done: dict[Expr, Expr] = {}
    for start in assigned:
        stack = [start]
        while stack:
            symbol = stack[-1]
            missing = [
                part for part in sorted(assigned[symbol].free_symbols, key=str) if part in assigned and part not in done
            ]
            if missing:
                stack.extend(missing)
                continue
            stack.pop()
            done.setdefault(symbol, assigned[symbol])
    return list(done.items())

"""The user's statement: the equations of a minimal set, the unknowns to eliminate and the variable that stays."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from keyword import iskeyword
from typing import Any

import sympy as sp

from rootmatch.derivation.leaves import COMMON, Expr
from rootmatch.errors import InputError, escape_unprintable, quote_value
from rootmatch.problems.derived.measurements import Measurement
from rootmatch.problems.derived.store import FUNCTIONS

Equations = Callable[..., Any]
_PLAIN = re.compile(r"[a-z][a-zA-Z0-9_]*\Z")
_OWN = re.compile(r"([deh]|ss?|tt?)\d+(_\d+)?\Z")
"""Names of leaves, definitions and common subexpressions in generated code."""


@dataclass(frozen=True)
class Statement:
    """A minimal problem in the user's words."""

    equations: Equations
    """``(X, u) -> expressions that vanish``, of all correspondences of a minimal set (lists of column vectors), or of
    one correspondence (two column vectors) if ``each``."""
    each: bool
    minimal: int
    shared: Expr
    eliminate: tuple[Expr, ...]
    local: tuple[Expr, ...]
    """With ``each``: unknowns of which every correspondence has its own."""
    source: Measurement
    target: Measurement
    positive: Equations | None = None
    """``(X, u) -> expressions`` of a minimal set in the shared variable and what is measured, positive at the truth."""

    def conditions(self, X: Sequence[Any], u: Sequence[Any]) -> list[Expr]:
        """Expressions that must be positive at a true root."""
        return [] if self.positive is None else self._expressions("positive", self.positive, list(X), list(u))

    def build(self, X: Sequence[Any], u: Sequence[Any]) -> list[Expr]:
        """Expressions for correspondences given by symbols; local unknowns are named after their places."""
        if not self.each:
            made = self._expressions("equations", self.equations, list(X), list(u))
        else:
            made = []
            for number, (point, image) in enumerate(zip(X, u, strict=True)):
                swap = self.copies(number)
                made += [e.xreplace(swap) for e in self._expressions("each", self.equations, point, image)]
        return [e for e in made if e != 0]

    def copies(self, place: int) -> dict[Expr, Expr]:
        """Local unknowns to their copies at a place."""
        return {symbol: sp.Symbol(f"{symbol.name}__{place}") for symbol in self.local}

    @property
    def places_of_copies(self) -> dict[Expr, int]:
        """The copies of local unknowns in a minimal set, each with its place."""
        return {copy: place for place in range(self.minimal) for copy in self.copies(place).values()}

    @property
    def unknowns(self) -> list[Expr]:
        """All that is to be eliminated from a minimal set."""
        return [*self.eliminate, *self.places_of_copies]

    def _expressions(self, name: str, function: Equations, X: Any, u: Any) -> list[Expr]:
        """The result of the user's function for some points, as a flat list."""
        try:
            made = function(X, u)
        except Exception as error:
            raise InputError(
                f"{name}: the function failed with {type(error).__name__} ({escape_unprintable(str(error))[:200]}); "
                "points are SymPy column vectors: add numbers to single entries; * is the matrix product"
            ) from error
        return _flatten(name, made)

    def check(self, measured: set[Expr], built: Sequence[Expr], conditions: Sequence[Expr]) -> None:
        """Refuse a statement that makes no sense."""
        known = measured | set(self.unknowns) | {self.shared}
        strange = sorted({str(s) for e in built for s in e.free_symbols if s not in known})
        if strange:
            raise InputError(
                f"equations: the symbols {', '.join(strange)} are neither measured nor unknown; name them in "
                "eliminate= (or local=), or replace them by numbers"
            )
        strange = sorted({str(s) for e in conditions for s in e.free_symbols if s not in measured | {self.shared}})
        if strange:
            raise InputError(
                f"positive: {', '.join(strange)} are neither measured nor the shared variable; express them in "
                "terms of these"
            )
        for label, expressions in (("equations", built), ("positive", conditions)):
            called = {type(call).__name__ for e in expressions for call in e.atoms(sp.core.function.Application)}
            strange = sorted(called - FUNCTIONS.keys())
            strange += ["the imaginary unit"] if any(e.has(sp.I) for e in expressions) else []
            if strange:
                raise InputError(
                    f"{label}: {', '.join(strange)} given, other than arithmetic and {', '.join(FUNCTIONS)}; rewrite it"
                )
        name = str(self.shared)
        if not _PLAIN.match(name) or _OWN.match(name) or name in FUNCTIONS or iskeyword(name):
            raise InputError(
                f"shared: a symbol of the name {quote_value(name)} cannot stand in generated code; name it by a word "
                "of small letters, such as x"
            )
        if not any(self.shared in e.free_symbols for e in built):
            raise InputError(f"shared: {self.shared} does not occur in the equations")
        if not any(measured & e.free_symbols for e in built):
            raise InputError("equations: nothing measured occurs in them")

    def places_of_unknowns(self, built: Sequence[Expr], slot_of: dict[Expr, int]) -> dict[Expr, tuple[int, ...]]:
        """Correspondences that each unknown belongs to: those of all equations that hold it; () for all of them.

        An equation without measurements (b = x a) belongs where its other unknowns do.
        """
        unknowns = [*self.unknowns, self.shared]
        found: dict[Expr, set[int]] = {symbol: {place} for symbol, place in self.places_of_copies.items()}
        where = [{slot_of[s] for s in e.free_symbols if slot_of.get(s, COMMON) != COMMON} for e in built]
        for symbol in unknowns:
            holding = [slots for e, slots in zip(built, where, strict=True) if symbol in e.free_symbols and slots]
            if symbol not in found and holding:
                found[symbol] = set.intersection(*holding)
        for symbol in unknowns:
            if symbol not in found:
                others = [found[s] for e in built if symbol in e.free_symbols for s in e.free_symbols if found.get(s)]
                found[symbol] = set().union(*others)
        return {symbol: tuple(sorted(places)) for symbol, places in found.items()}

    def digest(self, built: Sequence[Expr], extra: str) -> str:
        """Digest of everything that the generated code depends on."""
        parts = [
            *(sp.srepr(e) for e in built),
            str(self.minimal),
            str(self.shared),
            str(self.unknowns),
            self.source.key,
            self.target.key,
            extra,
        ]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _flatten(name: str, made: Any) -> list[Expr]:
    if isinstance(made, sp.Equality):
        made = made.lhs - made.rhs
    if isinstance(made, list | tuple | sp.MatrixBase):
        return [expression for item in made for expression in _flatten(name, item)]
    if isinstance(made, bool | sp.logic.boolalg.Boolean):
        raise InputError(f"{name}: {quote_value(made)} returned, a comparison; return the difference of both sides")
    expression = made if isinstance(made, str) else sp.sympify(made, strict=False) if made is not None else None
    if not isinstance(expression, sp.Expr):
        raise InputError(f"{name}: {quote_value(made)} returned; return SymPy expressions")
    if expression.has(sp.nan, sp.oo, -sp.oo, sp.zoo):
        raise InputError(f"{name}: an expression holds NaN or infinity; check its numbers and what it divides by")
    return [expression]

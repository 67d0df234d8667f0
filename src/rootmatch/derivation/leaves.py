"""Leaves: the measured quantities of one or two points that a derived polynomial is made of.

Elimination with raw coordinates drowns in symbols. Yet what the unknowns of an equation are multiplied with is mostly a
function of few points: a cosine of two bearings, a squared distance. Each such quantity becomes one symbol, a *leaf*; a
leaf of one or two points of one set is tabulated before the hot loop, so that it costs a load there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import sympy as sp

from rootmatch.errors import InputError
from rootmatch.problems.derived.measurements import Measurement

Expr = Any
"""A SymPy expression; SymPy carries no types."""
COMMON = -1
"""Stands for a slot where a coordinate is the same for all points."""
Class = str
"""``"s"``, ``"t"``: of one source or target point; ``"ss"``, ``"tt"``: of two."""


@dataclass(frozen=True)
class Use:
    """A leaf as it stands in a minimal set: which quantity, of the points in which slots."""

    kind: Class
    index: int
    slots: tuple[int, ...]

    @property
    def entry(self) -> tuple[str, int, tuple[int, ...]]:
        """The use as the plan of a generated module has it."""
        return self.kind, self.index, self.slots

    @property
    def name(self) -> str:
        """Name of its symbol, also in generated code."""
        return f"{self.kind}{self.index}_{''.join(map(str, self.slots))}"


@dataclass
class Leaves:
    """Registry of the leaves of one derivation."""

    source: Measurement
    target: Measurement
    minimal: int
    """Correspondences of a minimal set: the slots."""
    functions: dict[Class, list[Expr]] = field(default_factory=lambda: {"s": [], "ss": [], "t": [], "tt": []})
    """Measured quantities of each class, in the coordinates of a first and a second point."""
    uses: dict[Expr, Use] = field(default_factory=dict)
    raw: dict[Expr, Expr] = field(default_factory=dict)
    """Leaf symbol to its expression in measured coordinates."""
    named: dict[Expr, Expr] = field(default_factory=dict)
    """Other symbols that stand for expressions in leaves."""

    def __post_init__(self) -> None:
        self._where: dict[Expr, tuple[str, int, int]] = {}
        self.points: dict[str, list[Any]] = {}
        for side, what in (("s", self.source), ("t", self.target)):
            letter = "X" if side == "s" else "u"
            self.points[side] = []
            for slot in range(self.minimal):
                symbols = [sp.Symbol(name, real=True) for name in what.names(letter, slot)]
                own = what.coordinates - what.common
                self._where |= {symbol: (side, slot if k < own else COMMON, k) for k, symbol in enumerate(symbols)}
                self.points[side].append(sp.Matrix(symbols))

    def slots(self) -> dict[Expr, int]:
        """Measured symbols to the slot of their point, or `COMMON`."""
        return {symbol: slot for symbol, (_, slot, _) in self._where.items()}

    def measured(self, expression: Expr) -> list[Expr]:
        """The measured coordinates in an expression, by name: leaves are numbered as these are met.

        SymPy's sets of symbols have another order in each process, in which generated code must not differ.
        """
        return sorted((symbol for symbol in expression.free_symbols if symbol in self._where), key=str)

    def points_of(self, expression: Expr) -> set[tuple[str, int]]:
        """The points that an expression in coordinates or leaves depends on, as (side, slot)."""
        coordinates = {self._where[symbol][:2] for symbol in expression.free_symbols if symbol in self._where}
        found = {point for point in coordinates if point[1] != COMMON}
        for symbol in expression.free_symbols:
            if symbol in self.uses:
                use = self.uses[symbol]
                found |= {(use.kind[0], slot) for slot in use.slots}
        # what is the same for all points is read at the first
        return found or {(side, 0) for side, _ in coordinates}

    def resolve_names(self, expression: Expr) -> Expr:
        """The expression without named symbols."""
        while expression.free_symbols & self.named.keys():
            expression = expression.xreplace(self.named)
        return expression

    def can_be_tabulated(self, expression: Expr) -> bool:
        """Whether it depends on one or two points of one set, so that a table can hold it."""
        points = self.points_of(expression)
        sides = {side for side, _ in points} | {self._where[s][0] for s in self.measured(expression)}
        return 1 <= len(points) <= 2 and len(sides) == 1

    def placeholders(self, kind: Class) -> list[Expr]:
        """Symbols of the coordinates of a leaf's first and second point, in the order of its function's arguments."""
        what = self.source if kind[0] == "s" else self.target
        return [sp.Symbol(f"{point}{name}", real=True) for point in ("a", "b")[: len(kind)] for name in what.letters]

    def leaf(self, expression: Expr) -> Expr:
        """The leaf of an expression in coordinates or leaves, times a number where it is a multiple of a known one."""
        expression = expression.xreplace(self.raw)
        number, rest = expression.as_coeff_Mul()
        if rest.could_extract_minus_sign():
            number, rest = -number, -rest
        points = sorted(self.points_of(rest))
        side, slots = points[0][0], tuple(slot for _, slot in points)
        kind = side * len(slots)
        functions = self.functions[kind]
        expanded = [sp.expand(known) for known in functions]
        orders = [slots] if len(slots) == 1 else [slots, slots[::-1]]
        for order in orders:
            function = self._substitute_placeholders(rest, kind, order)
            wanted = sp.expand(function)
            for index, known in enumerate(expanded):
                ratio = _ratio(wanted, known)
                if ratio is not None:
                    return number * ratio * self._symbol(Use(kind, index, self._ascending_slots(kind, index, order)))
        functions.append(self._substitute_placeholders(rest, kind, slots))
        return number * self._symbol(Use(kind, len(functions) - 1, slots))

    def _ascending_slots(self, kind: Class, index: int, slots: tuple[int, ...]) -> tuple[int, ...]:
        """Slots in ascending order where the quantity is symmetric in its points."""
        if len(slots) < 2 or slots[0] < slots[1]:
            return slots
        symbols = self.placeholders(kind)
        half = len(symbols) // 2
        swap = dict(zip(symbols, symbols[half:] + symbols[:half], strict=True))
        function = self.functions[kind][index]
        symmetric = sp.expand(function - function.xreplace(swap)) == 0
        return slots[::-1] if symmetric else slots

    def _substitute_placeholders(self, expression: Expr, kind: Class, slots: tuple[int, ...]) -> Expr:
        symbols = self.placeholders(kind)
        what = symbols[: len(symbols) // len(kind)], symbols[len(symbols) // len(kind) :]
        swap = {}
        for symbol in self.measured(expression):
            _, slot, k = self._where[symbol]
            swap[symbol] = what[0 if slot == COMMON else slots.index(slot)][k]
        return expression.xreplace(swap)

    def _symbol(self, use: Use) -> Expr:
        symbol = sp.Symbol(use.name, real=True)
        if symbol not in self.uses:
            self.uses[symbol] = use
            symbols = self.placeholders(use.kind)
            coordinates = [self.points[use.kind[0]][slot][k] for slot in use.slots for k in range(self._size(use.kind))]
            function = self.functions[use.kind][use.index]
            self.raw[symbol] = function.xreplace(dict(zip(symbols, coordinates, strict=True)))
        return symbol

    def _size(self, kind: Class) -> int:
        return (self.source if kind[0] == "s" else self.target).coordinates

    def abstract(self, expression: Expr, unknowns: set[Expr]) -> Expr:
        """The expression with every largest tabulated part that is free of the unknowns put as a leaf."""
        if not self.measured(expression):
            return expression
        free = not (expression.free_symbols & unknowns)
        if free and self.can_be_tabulated(expression):
            return self.leaf(expression)
        if expression.is_Add or expression.is_Mul:
            rest: list[Expr] = []
            groups: dict[tuple[tuple[str, int], ...], list[Expr]] = {}
            for part in expression.args:
                if self.measured(part) and not (part.free_symbols & unknowns) and self.can_be_tabulated(part):
                    groups.setdefault(tuple(sorted(self.points_of(part))), []).append(part)
                else:
                    rest.append(self.abstract(part, unknowns))
            joined = self._merge_groups(list(groups.values()), expression.func)
            return expression.func(*rest, *(self.leaf(expression.func(*group)) for group in joined))
        if expression.is_Pow and not (expression.exp.free_symbols):
            return sp.Pow(self.abstract(expression.base, unknowns), expression.exp)
        raise InputError(f"equations: {expression} mixes points in a way that is not polynomial; rewrite it")

    def _merge_groups(self, groups: list[list[Expr]], join: Any) -> list[list[Expr]]:
        """Groups of parts merged while what they form together can still be tabulated."""
        merged: list[list[Expr]] = []
        for group in sorted(groups, key=lambda parts: -len(self.points_of(join(*parts)))):
            for other in merged:
                if self.can_be_tabulated(join(*other, *group)):
                    other.extend(group)
                    break
            else:
                merged.append(list(group))
        return merged


def _ratio(one: Expr, other: Expr) -> Expr | None:
    """The number that one is of the other, both expanded; None if there is none."""
    if one == other:
        return sp.Integer(1)
    if one == sp.expand(-other):
        return sp.Integer(-1)
    return None

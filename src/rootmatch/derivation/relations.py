"""Which root goes with which: relations between the shared variables of two orders of one minimal set.

Where the shared variable belongs to some of the correspondences (a ratio of two depths), a hyper-edge has several of
them, x for one order of the minimal set and y for another. Each has its own polynomial with its own roots; which root y
belongs to the same solution as a root x follows from the equations with everything but x and y eliminated.
"""

from __future__ import annotations

from typing import Any

import sympy as sp

from rootmatch.derivation.check import Judge, Order
from rootmatch.derivation.elimination import Definitions, eliminate, make_polynomials
from rootmatch.derivation.hoisting import sort_leaves
from rootmatch.derivation.leaves import Leaves
from rootmatch.derivation.statement import Statement
from rootmatch.derivation.straight_line import Program, function_text
from rootmatch.errors import InputError
from rootmatch.problems.derived.text import Use, root_order

Uses = tuple[Use, ...]


def relation_texts(
    statement: Statement, leaves: Leaves, judge: Judge, orders: tuple[Order, ...]
) -> tuple[list[str], dict[Order, int], dict[Order, Uses]]:
    """Functions ``relation_…(x, y, leaves) → e₀, ∂e₀/∂y, e₁, …``, how many relations each has, and their arguments."""
    texts: list[str] = []
    counts: dict[Order, int] = {}
    arguments: dict[Order, Uses] = {}
    for base in dict.fromkeys(root_order(order) for order in orders):
        if base == judge.first:
            continue
        try:
            text, uses, count = _relation(statement, leaves, base)
        except InputError:
            continue
        texts.append(text)
        counts[base] = count
        arguments[base] = uses
    return texts, counts, arguments


def _relation(statement: Statement, leaves: Leaves, base: Order) -> tuple[str, Uses, int]:
    m = statement.minimal
    X, u = leaves.points["s"], leaves.points["t"]
    x = statement.shared
    first = statement.build(X, u)
    places = statement.places_of_unknowns(first, leaves.slots())
    other = statement.build([X[k] for k in base], [u[k] for k in base])
    y = sp.Symbol(f"{x.name}__other")
    # an unknown of correspondence k in the first order is that of the same correspondence in the other
    owner = {places[symbol]: symbol for symbol in statement.unknowns if len(places[symbol]) < m}
    swap = {x: y}
    for symbol in statement.unknowns:
        moved = tuple(sorted(base[k] for k in places[symbol]))
        if len(places[symbol]) < m and moved in owner:
            swap[symbol] = owner[moved]
    other = [e.xreplace(swap) for e in other]
    everything = {*statement.unknowns, x, y}
    unique: list[Any] = []
    for e in [*first, *other]:
        if not any(sp.expand(e - known) == 0 or sp.expand(e + known) == 0 for known in unique):
            unique.append(e)
    definitions = Definitions(leaves)
    abstracted = [leaves.abstract(e, everything) for e in unique]
    polynomials = eliminate(
        make_polynomials(abstracted, [*statement.unknowns, x, y]), statement.unknowns, [x, y], definitions
    )
    polynomials = [p for p in polynomials if p.degree(y) > 0]
    if not polynomials:
        raise InputError("elimination: no equation is left that relates the two variables")
    program = Program(definitions.entries)
    outputs = [output for p in polynomials for output in (p.as_expr(), p.diff(y).as_expr())]
    inputs: set[Any] = set().union(*(program.inputs(output) for output in outputs))
    uses = sort_leaves(leaves, inputs)
    name = "relation_" + "".join(map(str, base))
    text = function_text(
        name, [x, y, *uses], outputs, program, "What vanishes where x and y are of one solution, and its slope in y."
    )
    return (text, tuple(leaves.uses[symbol].entry for symbol in uses), len(polynomials))

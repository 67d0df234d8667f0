"""Generation of a module's text from a polynomial in the shared variable."""

from __future__ import annotations

import pprint
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from rootmatch.derivation.hoisting import Hoisted, grading_key, hoist, open_definitions, sort_leaves
from rootmatch.derivation.leaves import Expr, Leaves
from rootmatch.derivation.straight_line import Program, function_text
from rootmatch.errors import InputError

FORMAT = 8
"""Version of the generated modules; older ones are generated anew."""


@dataclass
class Draft:
    """Functions and plan of a module before its constraints are known."""

    plan: dict[str, Any]
    functions: list[str]

    def text(self, header: str) -> str:
        """Source of the module."""
        plan = pprint.pformat(self.plan, width=118, compact=True, sort_dicts=False)
        return f'"""{header}"""\n\nplan = {plan}\n\n\n' + "\n\n".join(self.functions)


def draft(
    leaves: Leaves,
    definitions: dict[Expr, Expr],
    coefficients: Sequence[Expr],
    value: Expr,
    x: Expr,
    positive: Sequence[Expr],
) -> Draft:
    """Functions for the polynomial Σ c_k x^k, coefficients given highest degree first, and its value at x.

    ``positive`` are expressions in leaves and x that are positive at a true root.
    """
    split, entries = _choose_split(
        leaves, definitions, list(coefficients), value, _swept_conditions(leaves, definitions, positive)
    )
    program = Program(entries)
    # a value in a shorter form than that of the coefficients may be made of other leaves
    inputs: set[Expr] = set().union(*(program.inputs(c) for c in (*coefficients, value)))
    arguments = sort_leaves(leaves, inputs)
    noisy = [k for k, symbol in enumerate(arguments) if _is_noisy(leaves, symbol)]
    gradient = program.gradient(value, [arguments[k] for k in noisy])
    told = "Coefficients of a minimal set, highest degree first."
    texts = [
        function_text("polynomial", arguments, coefficients, program, told),
        function_text(
            "partials", [x, *arguments], gradient, program, "Derivatives of the value at x in the noisy arguments."
        ),
    ]
    conditions = sort_leaves(leaves, set().union(*(program.inputs(c) for c in positive)))
    if positive:
        texts.append(
            function_text("positive", [x, *conditions], positive, program, "What is positive at a true root x.")
        )
    row_plan, row_texts = _row(leaves, split, x)
    texts += row_texts + _leaf_texts(leaves, row_plan, [*arguments, *conditions])
    plan = {
        "format": FORMAT,
        "minimal": leaves.minimal,
        "degree": len(coefficients) - 1,
        "source": leaves.source.key,
        "target": leaves.target.key,
        "leaves": {kind: len(functions) for kind, functions in leaves.functions.items()},
        "arguments": [leaves.uses[symbol].entry for symbol in arguments],
        "noisy": noisy,
        "positive": [leaves.uses[symbol].entry for symbol in conditions],
        "conditions": len(positive),
        **row_plan,
    }
    return Draft(plan, texts)


def _swept_conditions(leaves: Leaves, definitions: dict[Expr, Expr], conditions: Sequence[Expr]) -> list[Expr]:
    """Conditions in which the last correspondence takes part."""
    program = Program(definitions)
    last = leaves.minimal - 1
    return [c for c in conditions if any(last in leaves.uses[s].slots for s in program.inputs(c) & leaves.uses.keys())]


def _is_noisy(leaves: Leaves, symbol: Expr) -> bool:
    what = leaves.source if leaves.uses[symbol].kind[0] == "s" else leaves.target
    return what.noise_dimensions > 0


def _choose_split(
    leaves: Leaves, definitions: dict[Expr, Expr], coefficients: list[Expr], value: Expr, positive: list[Expr]
) -> tuple[Hoisted, dict[Expr, Expr]]:
    """Split by quantities of two target points or by the coordinates of the last one, whichever costs less."""
    dimensions = leaves.minimal * (leaves.source.noise_dimensions + leaves.target.noise_dimensions)
    choices = []
    closed = hoist(leaves, definitions, coefficients, value, positive)
    if closed is not None:
        choices.append((closed.cost(dimensions), 0, closed, definitions))
    if any(use.kind == "tt" for use in leaves.uses.values()):
        entries = open_definitions(leaves, definitions)
        raw = hoist(leaves, entries, coefficients, value, positive)
        if raw is not None:
            choices.append((raw.cost(dimensions), 1, raw, entries))
    if not choices:
        raise InputError(
            "equations: what is measured of a target point stands in a denominator or under a root together with "
            "other points; multiply out, or make it an unknown of its own"
        )
    _, _, split, entries = min(choices, key=lambda choice: choice[:2])
    if not any(split.coefficients):
        raise InputError("elimination: the polynomial vanishes for all measurements; the equations are dependent")
    return split, entries


def _row(leaves: Leaves, split: Hoisted, x: Expr) -> tuple[dict[str, Any], list[str]]:
    """Functions of what does not depend on the last target point, and the plan of their outputs."""
    program = split.program
    terms = [
        (m, powers, value)
        for m, one in enumerate(split.value)
        for powers, value in sorted(one.items(), key=lambda item: grading_key(item[0]))
    ]
    signs = [
        (r, m, powers, value)
        for r, parts in enumerate(split.signs)
        for m, one in enumerate(parts)
        for powers, value in sorted(one.items(), key=lambda item: grading_key(item[0]))
    ]
    found = {powers for _, powers, _ in terms} | {powers for _, _, powers, _ in signs}
    row_monomials = sorted(found, key=grading_key)
    sign_inputs = sort_leaves(leaves, set().union(*(program.inputs(value) for *_, value in signs)))
    inputs: set[Expr] = set().union(*(program.inputs(value) for _, _, value in terms))
    stem = sort_leaves(leaves, inputs)
    parts = [value for _, _, value in terms]
    middle = _middle(leaves, program, parts)
    direct, couplings, inner = [], [], []
    for n, value in enumerate(parts):
        slope = sp.diff(value, x)
        if slope != 0:
            direct.append((n, slope))
        couplings += [(k, n, sp.diff(value, part)) for k, part in enumerate(middle) if part in value.free_symbols]
    noisy = [k for k, symbol in enumerate(stem) if _is_noisy(leaves, symbol)]
    for k, part in enumerate(middle):
        gradient = program.gradient(part, [x, *(stem[place] for place in noisy)])
        inner += [
            (k, place, derivative) for place, derivative in zip([-1, *noisy], gradient, strict=True) if derivative != 0
        ]
    inputs = set().union(*(program.inputs(value) for one in split.coefficients for value in one.values()))
    hoisted = [symbol for symbol in sort_leaves(leaves, inputs) if symbol not in split.last]
    coefficients = [
        (power, split.monomials.index(powers))
        for power, one in enumerate(reversed(split.coefficients))
        for powers in sorted(one, key=split.monomials.index)
    ]
    row = [split.coefficients[-1 - power][split.monomials[m]] for power, m in coefficients]
    plan = {
        "last": [leaves.uses[symbol].entry for symbol in split.last],
        "monomials": split.monomials,
        "row_last": [leaves.uses[symbol].entry for symbol in split.row],
        "row_monomials": row_monomials,
        "terms": [(m, row_monomials.index(powers)) for m, powers, _ in terms],
        "stem": [leaves.uses[symbol].entry for symbol in stem],
        "sign_terms": [(r, m, row_monomials.index(powers)) for r, m, powers, _ in signs],
        "sign_stem": [leaves.uses[symbol].entry for symbol in sign_inputs],
        "slopes": [n for n, _ in direct],
        "couplings": [(k, n) for k, n, _ in couplings],
        "inner": [(k, place) for k, place, _ in inner],
        "hoisted": [leaves.uses[symbol].entry for symbol in hoisted],
        "row": coefficients,
    }
    texts = [
        function_text(
            "at_root",
            [x, *stem],
            [*parts, *(e for _, e in direct), *(e for _, _, e in couplings), *(e for _, _, e in inner)],
            program,
            "Coefficients of the terms at x, their slopes, their derivatives in inner quantities, and those of these.",
        ),
        function_text(
            "row", hoisted, row, program, "Coefficients of the monomials in the last quantities, of each power of x."
        ),
    ]
    if signs:
        texts.append(
            function_text(
                "signs", [x, *sign_inputs], [value for *_, value in signs], program, "Terms of what is positive at x."
            )
        )
    return plan, texts


def _middle(leaves: Leaves, program: Program, parts: Sequence[Expr]) -> list[Expr]:
    """Inner quantities through which noise reaches the terms: names and leaves that occur in them, or leaves alone.

    The names are fewer than the terms where an elimination left a short inner form (cofactors of a determinant).
    """
    occurring = sorted({symbol for part in parts for symbol in part.free_symbols}, key=str)
    return [
        symbol
        for symbol in occurring
        if any(_is_noisy(leaves, leaf) for leaf in program.inputs(symbol) if leaf in leaves.uses)
        or (symbol in program.entries and any(leaf not in leaves.uses for leaf in program.inputs(symbol)))
    ]


def _leaf_texts(leaves: Leaves, row: dict[str, Any], arguments: Sequence[Expr]) -> list[str]:
    used = {leaves.uses[symbol].entry[:2] for symbol in arguments}
    used |= {
        tuple(use[:2]) for use in (*row["hoisted"], *row["last"], *row["stem"], *row["row_last"], *row["sign_stem"])
    }
    texts = []
    for kind, functions in leaves.functions.items():
        symbols = leaves.placeholders(kind)
        what = leaves.source if kind[0] == "s" else leaves.target
        for index, function in enumerate(functions):
            if (kind, index) not in used:
                continue
            name = f"leaf_{kind}{index}"
            texts.append(function_text(name, symbols, [function], Program(), f"Quantity {index} of {_WORDS[kind]}."))
            if what.noise_dimensions:
                derivatives = [sp.diff(function, symbol) for symbol in symbols]
                texts.append(
                    function_text(f"{name}_partials", symbols, derivatives, Program(), "Its derivatives in each.")
                )
    return texts


_WORDS = {"s": "a source point", "ss": "two source points", "t": "a target point", "tt": "two target points"}

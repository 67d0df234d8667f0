"""Text of the loops around a derived problem's formulas: edge and slab kernels, composed from its plan.

The formulas (see `rootmatch.derivation.generate`) know nothing of tables and loops. This module writes the code
that loads their arguments, propagates noise through them and sweeps the last correspondence; every loop over
quantities, monomials and noise dimensions is unrolled, so LLVM sees straight-line arithmetic around one loop.

Words used in the text. *Places*: a minimal set takes correspondences of the hyper-edge in some order; ``(0, 2, 3)``
puts correspondence 3, the swept one, last. *Dimensions*: (correspondence, side, axis) of the noise. *h*: what is
computed before the loop over the last target point; *q*: quantities of that point; *m*: their monomials.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

Use = tuple[str, int, tuple[int, ...]]
Dimension = tuple[int, str, int]


@dataclass(frozen=True)
class Shape:
    """A plan, with what the composition needs beside it."""

    plan: dict[str, Any]
    """Of a generated module."""
    source_noise: int
    target_noise: int
    """Noise dimensions of a point."""

    @property
    def minimal(self) -> int:
        """Correspondences of a minimal set."""
        return int(self.plan["minimal"])

    @property
    def degree(self) -> int:
        """Degree of the polynomial."""
        return int(self.plan["degree"])

    def axes(self, side: str) -> int:
        """Noise dimensions of a point of that side."""
        return self.source_noise if side == "s" else self.target_noise

    def dimensions(self, places: Any) -> list[Dimension]:
        """Noise dimensions of the given correspondences, the last target point's left out."""
        return [
            (place, side, axis)
            for place in places
            for side in ("s", "t")
            for axis in range(self.axes(side))
            if not (place == self.minimal and side == "t")
        ]


TABLES = {"s": "source", "ss": "source_pair", "t": "target", "tt": "target_pair"}


def index(side: str, place: int, minimal: int) -> str:
    """Name of a correspondence's source or target index."""
    if place == minimal:
        return "d" if side == "s" else "k"
    return f"{'i' if side == 's' else 'j'}{place}"


def load(shape: Shape, use: Use, places: tuple[int, ...]) -> str:
    """A quantity out of its table."""
    kind, number, slots = use
    at = ", ".join(index(kind[0], places[slot], shape.minimal) for slot in slots)
    return f"t.{TABLES[kind]}[{number}, {at}]"


def noise_load(shape: Shape, use: Use, places: tuple[int, ...], dimension: Dimension) -> str | None:
    """The derivative of a quantity in one noise dimension, read from its table; None where it does not depend on it."""
    kind, number, slots = use
    place, side, axis = dimension
    axes = shape.axes(side)
    if kind[0] != side or place not in [places[slot] for slot in slots]:
        return None
    end = [places[slot] for slot in slots].index(place)
    row = number * len(slots) * axes + end * axes + axis
    at = ", ".join(index(side, places[slot], shape.minimal) for slot in slots)
    return f"t.{TABLES[kind]}_noise[{row}, {at}]"


def names(prefix: str, count: int) -> list[str]:
    """``prefix0, prefix1, …``."""
    return [f"{prefix}{k}" for k in range(count)]


def label(dimension: Dimension) -> str:
    """A dimension as part of a name."""
    return f"{dimension[1]}{dimension[0]}{'xyz'[dimension[2]]}"


def bases(shape: Shape) -> str:
    """Parameters that name the correspondences of the minimal set."""
    return ", ".join(names("i", shape.minimal) + names("j", shape.minimal))


def suffix(places: tuple[int, ...]) -> str:
    """An order as part of a name."""
    return "_" + "".join(map(str, places))


def coefficient_names(degree: int, letter: str = "c") -> str:
    """Coefficients, highest degree first."""
    return ", ".join(f"{letter}{k}" for k in range(degree, -1, -1))


def root_order(order: tuple[int, ...]) -> tuple[int, ...]:
    """Order of the first correspondences whose root a constraint has, where the unknown belongs to some of them."""
    head = order[:-1]
    return (*head, *(k for k in range(len(order)) if k not in head))


def noise_terms(shape: Shape, partials: list[str], order: tuple[int, ...], dimension: Dimension) -> list[str]:
    """Summands of the value's derivative in one noise dimension, from those in its noisy arguments."""
    noisy = (noise_load(shape, shape.plan["arguments"][k], order, dimension) for k in shape.plan["noisy"])
    return [f"{name} * {noise}" for name, noise in zip(partials, noisy, strict=True) if noise is not None]


def polynomial_text(shape: Shape, order: tuple[int, ...]) -> str:
    """``polynomial_…(t, i…, j…) → c…`` of the first correspondences in an order."""
    loads = ", ".join(load(shape, use, order) for use in shape.plan["arguments"])
    return f"@kernel\ndef polynomial{suffix(order)}(t, {bases(shape)}):\n    return polynomial({loads})\n"


def horner_lines(degree: int) -> list[str]:
    """Statements for value, slope and half the curvature at x."""
    lines = [f"value = c{degree}", "slope = 0.0", "half = 0.0"]
    for k in range(degree - 1, -1, -1):
        lines += ["half = half * x + slope", "slope = slope * x + value", f"value = value * x + c{k}"]
    return lines


def conditions(shape: Shape) -> int:
    """How many quantities of a swept set must be positive at a root."""
    return 1 + max((r for r, _, _ in shape.plan["sign_terms"]), default=-1)


def state_text(shape: Shape, order: tuple[int, ...], interval: tuple[float, float] | None) -> str:
    """``state_…(t, i…, j…, c…, x) → good, dx/d(noise)…``: is a candidate a root within noise, and its response."""
    plan = shape.plan
    loads = ", ".join(["x", *(load(shape, use, order) for use in plan["arguments"])])
    partials = names("p", len(plan["noisy"]))
    dimensions = shape.dimensions(range(shape.minimal))
    lines = [
        f"@kernel\ndef state{suffix(order)}(t, {bases(shape)}, {coefficient_names(shape.degree)}, x):",
        f"    ({', '.join(partials)},) = partials({loads})",
        *(f"    {line}" for line in horner_lines(shape.degree)),
    ]
    squares = []
    for dimension in dimensions:
        terms = noise_terms(shape, partials, order, dimension)
        lines.append(f"    b_{label(dimension)} = {' + '.join(terms) or '0.0'}")
        squares.append(f"b_{label(dimension)} * b_{label(dimension)}")
    limits = f" and {interval[0]!r} < x < {interval[1]!r}" if interval is not None else ""
    if plan["conditions"]:
        loads = ", ".join(["x", *(load(shape, use, order) for use in plan["positive"])])
        found = names("o", plan["conditions"])
        lines.append(f"    ({', '.join(found)},) = positive({loads})")
        limits += "".join(f" and {name} > 0.0" for name in found)
    lines += [
        f"    variance = {' + '.join(squares)}",
        "    square = slope * slope + BLUR * 2.0 * abs(half) * math.sqrt(variance)",
        f"    good = value * value <= GATE2 * variance and 0.0 < square < math.inf{limits}",
        "    inverse = (-1.0 if slope >= 0.0 else 1.0) / math.sqrt(square if square > 0.0 else 1.0)",
        f"    return good, {', '.join(f'b_{label(d)} * inverse' for d in dimensions)}",
    ]
    return "\n".join(lines) + "\n"


def monomial_text(powers: tuple[int, ...], variables: list[str]) -> str:
    """A product of powers; ``1.0`` for none."""
    factors = [name for name, power in zip(variables, powers, strict=True) for _ in range(power)]
    return " * ".join(factors) or "1.0"


def value_monomials(shape: Shape) -> list[int]:
    """Monomials of the last target's quantities that the polynomial holds; others may stand in conditions only."""
    return sorted({m for m, _ in shape.plan["terms"]})


def slope_of_monomial(powers: tuple[int, ...], variable: int, variables: list[str]) -> str | None:
    """Derivative of a product of powers in one of its variables; None where it is zero."""
    power = powers[variable]
    if not power:
        return None
    rest = tuple(p - (k == variable) for k, p in enumerate(powers))
    product = monomial_text(rest, variables)
    factors = ([repr(float(power))] if power > 1 else []) + ([product] if product != "1.0" else [])
    return " * ".join(factors) or "1.0"

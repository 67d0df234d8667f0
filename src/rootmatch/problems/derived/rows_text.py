"""Text of what is computed once for a root, for a row and for a target point; see `text` for the words used.

The *stem* of a root holds what no last point moves. For each last source point d it makes a *row*: the coefficients of
the monomials in the last target's quantities, of the value and of its total derivative in every noise dimension.
"""

from __future__ import annotations

from typing import Any

from rootmatch.problems.derived.text import (
    Dimension,
    Shape,
    bases,
    conditions,
    label,
    load,
    monomial_text,
    names,
    noise_load,
    slope_of_monomial,
    value_monomials,
)


def passive(shape: Shape, orders: Any, shared: bool) -> tuple[int, ...]:
    """Places of the minimal set whose noise reaches the constraints through the root alone, so that one number does."""
    if shared:
        return ()
    used = {place for order in orders for place in order}
    return tuple(place for place in range(shape.minimal) if place not in used)


def base_dimensions(shape: Shape, merged: tuple[int, ...]) -> list[Dimension]:
    """Noise dimensions of the minimal set, those of each merged place as one, of side ``r``."""
    own = shape.dimensions([place for place in range(shape.minimal) if place not in merged])
    return own + [(place, "r", 0) for place in merged]


def merge_lines(shape: Shape, merged: tuple[int, ...]) -> list[str]:
    """Statements for the root's response to the noise of merged places."""
    lines = []
    for place in merged:
        squares = " + ".join(f"x_{label(d)} * x_{label(d)}" for d in shape.dimensions([place]))
        lines.append(f"x_{label((place, 'r', 0))} = math.sqrt({squares})")
    return lines


def inner_terms(shape: Shape, order: tuple[int, ...], base: list[Dimension]) -> dict[tuple[int, Dimension], str]:
    """Total derivative of each inner quantity in each noise dimension, as a sum; zeros are left out."""
    plan = shape.plan
    found: dict[tuple[int, Dimension], list[str]] = {}
    for number, (k, place) in enumerate(plan["inner"]):
        for dimension in base:
            if place < 0:
                factor: str | None = f"x_{label(dimension)}"
            else:
                factor = noise_load(shape, plan["stem"][place], order, dimension)
            if factor is not None:
                found.setdefault((k, dimension), []).append(f"p{number} * {factor}")
    return {key: " + ".join(sums) for key, sums in found.items()}


def stem_terms(shape: Shape, order: tuple[int, ...], base: list[Dimension]) -> dict[tuple[Dimension, int], str]:
    """Total derivative of each term in each noise dimension, as a sum; zeros are left out."""
    plan = shape.plan
    inner = inner_terms(shape, order, base)
    found: dict[tuple[Dimension, int], list[str]] = {}
    for dimension in base:
        for number, (k, n) in enumerate(plan["couplings"]):
            if (k, dimension) in inner:
                found.setdefault((dimension, n), []).append(f"k{number} * z{k}_{label(dimension)}")
        for n in plan["slopes"]:
            found.setdefault((dimension, n), []).append(f"s{n} * x_{label(dimension)}")
    return {key: " + ".join(sums) for key, sums in found.items()}


def stem_names(shape: Shape, order: tuple[int, ...], base: list[Dimension], prefix: str = "") -> list[str]:
    """Names of what a stem gives."""
    values = names(f"{prefix}a", len(shape.plan["terms"])) + names(f"{prefix}n", len(shape.plan["sign_terms"]))
    return values + [f"{prefix}e_{label(d)}_{n}" for d, n in stem_terms(shape, order, base)]


def stem_text(shape: Shape, name: str, order: tuple[int, ...], base: list[Dimension]) -> str:
    """``stem_…(t, i…, j…, d, x, dx…) → a…, e…``: of the set with the swept correspondence, what no last point moves.

    The value's coefficients of all terms, and their total derivatives in the noise, x moving along.
    """
    plan = shape.plan
    loads = ", ".join(["x", *(load(shape, use, order) for use in plan["stem"])])
    values, slopes = names("a", len(plan["terms"])), [f"s{n}" for n in plan["slopes"]]
    results = [*values, *slopes, *names("k", len(plan["couplings"])), *names("p", len(plan["inner"]))]
    moved = ", ".join(f"x_{label(d)}" for d in base)
    inner = inner_terms(shape, order, base)
    lines = [
        f"@kernel\ndef stem_{name}(t, {bases(shape)}, d, x, {moved}):",
        f"    ({', '.join(results)},) = at_root({loads})",
        *(f"    z{k}_{label(d)} = {text}" for (k, d), text in inner.items()),
    ]
    signs = names("n", len(plan["sign_terms"]))
    if signs:
        arguments = ", ".join(["x", *(load(shape, use, order) for use in plan["sign_stem"])])
        lines.append(f"    ({', '.join(signs)},) = signs({arguments})")
    lines += [
        f"    return ({', '.join([*values, *signs, *stem_terms(shape, order, base).values()])},)",
    ]
    return "\n".join(lines) + "\n"


def row_gradient(
    shape: Shape, order: tuple[int, ...], base: list[Dimension], prefix: str = ""
) -> dict[tuple[Dimension, int], str]:
    """Coefficient of each monomial in the total derivative of each noise dimension, in names of the stem."""
    plan = shape.plan
    inner = stem_terms(shape, order, base)
    variables = [load(shape, use, order) for use in plan["row_last"]]
    found: dict[tuple[Dimension, int], list[str]] = {}
    for dimension, n in inner:
        m, row = plan["terms"][n]
        found.setdefault((dimension, m), []).append(f"{prefix}e_{label(dimension)}_{n} * {prefix}w{row}")
    last = [d for d in shape.dimensions([shape.minimal]) if d[1] == "s"]
    for dimension in [*base, *last]:
        for n, (m, row) in enumerate(plan["terms"]):
            for v, use in enumerate(plan["row_last"]):
                noise = noise_load(shape, use, order, dimension)
                slope = slope_of_monomial(plan["row_monomials"][row], v, variables)
                if noise is not None and slope is not None:
                    found.setdefault((dimension, m), []).append(f"{prefix}a{n} * {slope} * {noise}")
    return {key: " + ".join(sums) for key, sums in found.items()}


def row_names(shape: Shape, order: tuple[int, ...], base: list[Dimension], prefix: str = "") -> list[str]:
    """Names of what is computed for a row: the value's coefficients, then those of its total derivative."""
    values = [f"{prefix}v{m}" for m in value_monomials(shape)]
    values += [f"{prefix}b{r}_{m}" for r, m in sign_monomials(shape)]
    return values + [f"{prefix}g_{label(d)}_{m}" for d, m in row_gradient(shape, order, base)]


def sign_monomials(shape: Shape) -> list[tuple[int, int]]:
    """Quantities that must be positive, each with the monomials of the last target that it holds."""
    return list(dict.fromkeys((r, m) for r, m, _ in shape.plan["sign_terms"]))


def sign_lines(shape: Shape, prefix: str = "") -> list[str]:
    """Statements for the quantities that must be positive, at the last target point."""
    lines = []
    for r in range(conditions(shape)):
        sums = [f"{prefix}b{r}_{m} * {prefix}m{m}" for q, m in sign_monomials(shape) if q == r]
        lines.append(f"{prefix}o{r} = {' + '.join(sums)}")
    return lines


def row_lines(shape: Shape, order: tuple[int, ...], base: list[Dimension], prefix: str = "") -> list[str]:
    """Statements that make them from the stem and the last source point d."""
    plan = shape.plan
    variables = [load(shape, use, order) for use in plan["row_last"]]
    lines = [f"{prefix}w{k} = {monomial_text(powers, variables)}" for k, powers in enumerate(plan["row_monomials"])]
    for m in value_monomials(shape):
        sums = [f"{prefix}a{n} * {prefix}w{row}" for n, (at, row) in enumerate(plan["terms"]) if at == m]
        lines.append(f"{prefix}v{m} = {' + '.join(sums)}")
    for r, m in sign_monomials(shape):
        sums = [
            f"{prefix}n{n} * {prefix}w{row}" for n, (q, at, row) in enumerate(plan["sign_terms"]) if (q, at) == (r, m)
        ]
        lines.append(f"{prefix}b{r}_{m} = {' + '.join(sums)}")
    for (dimension, m), text in row_gradient(shape, order, base, prefix).items():
        lines.append(f"{prefix}g_{label(dimension)}_{m} = {text}")
    return lines


def slope_text(shape: Shape, variable: int, prefix: str, variables: list[str]) -> str:
    """Derivative of Σ v_m m_m in one of the last quantities."""
    terms = []
    for m in value_monomials(shape):
        slope = slope_of_monomial(shape.plan["monomials"][m], variable, variables)
        if slope is not None:
            terms.append(f"{prefix}v{m}" if slope == "1.0" else f"{prefix}v{m} * {slope}")
    return " + ".join(terms) or "0.0"


class Rows:
    """Views of table rows that the inner loop reads, each once."""

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        self.views: dict[str, str] = {}

    def at(self, text: str) -> str:
        """Name of the entry at k of a load whose last index is k."""
        if not text.endswith(", k]"):
            raise ValueError(f"not a row of the last target point: {text}")
        view = text[: -len(", k]")] + "]"
        return self.views.setdefault(view, f"r{len(self.views)}")

    @property
    def lines(self) -> list[str]:
        """Statements that make the views."""
        return [f"{name} = {view}" for view, name in self.views.items()]

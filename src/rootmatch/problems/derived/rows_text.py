"""Text of what is computed once for a root, for a row and for a target point; see `text` for the words used.

The *stem* of a root holds what no last point moves. For each last source point d it makes a *row*: the coefficients of
the monomials in the last target's quantities, of the value and of its total derivative in every noise dimension.
"""

from __future__ import annotations

from functools import cached_property
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


def passive_places(shape: Shape, orders: Any, shared: bool) -> tuple[int, ...]:
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


def sign_monomials(shape: Shape) -> list[tuple[int, int]]:
    """Quantities that must be positive, each with the monomials of the last target that it holds."""
    return list(dict.fromkeys((r, m) for r, m, _ in shape.plan["sign_terms"]))


class Swept:
    """The text of one minimal set with the swept correspondence in it.

    Parameters
    ----------
    shape : Shape
    order : tuple of int
        Places of the set.
    base : list of Dimension
        Noise dimensions of the minimal set.
    prefix : str
        Begins the names of what is computed of it.
    """

    def __init__(self, shape: Shape, order: tuple[int, ...], base: list[Dimension], prefix: str = "") -> None:
        self.shape, self.plan, self.order, self.base, self.prefix = shape, shape.plan, order, base, prefix
        self.row_last = [load(shape, use, order) for use in self.plan["row_last"]]

    @cached_property
    def inner_terms(self) -> dict[tuple[int, Dimension], str]:
        """Total derivative of each inner quantity in each noise dimension, as a sum; zeros are left out."""
        found: dict[tuple[int, Dimension], list[str]] = {}
        for number, (k, place) in enumerate(self.plan["inner"]):
            for dimension in self.base:
                if place < 0:
                    factor: str | None = f"x_{label(dimension)}"
                else:
                    factor = noise_load(self.shape, self.plan["stem"][place], self.order, dimension)
                if factor is not None:
                    found.setdefault((k, dimension), []).append(f"p{number} * {factor}")
        return {key: " + ".join(sums) for key, sums in found.items()}

    @cached_property
    def stem_terms(self) -> dict[tuple[Dimension, int], str]:
        """Total derivative of each term in each noise dimension, as a sum; zeros are left out."""
        found: dict[tuple[Dimension, int], list[str]] = {}
        for dimension in self.base:
            for number, (k, n) in enumerate(self.plan["couplings"]):
                if (k, dimension) in self.inner_terms:
                    found.setdefault((dimension, n), []).append(f"k{number} * z{k}_{label(dimension)}")
            for n in self.plan["slopes"]:
                found.setdefault((dimension, n), []).append(f"s{n} * x_{label(dimension)}")
        return {key: " + ".join(sums) for key, sums in found.items()}

    @property
    def stem_names(self) -> list[str]:
        """Names of what a stem gives."""
        values = names(f"{self.prefix}a", len(self.plan["terms"]))
        values += names(f"{self.prefix}n", len(self.plan["sign_terms"]))
        return values + [f"{self.prefix}e_{label(d)}_{n}" for d, n in self.stem_terms]

    def stem_text(self, name: str) -> str:
        """``stem_…(t, i…, j…, d, x, dx…) → a…, e…``: of this set, what no last point moves.

        The value's coefficients of all terms, and their total derivatives in the noise, x moving along.
        """
        plan = self.plan
        loads = ", ".join(["x", *(load(self.shape, use, self.order) for use in plan["stem"])])
        values, slopes = names("a", len(plan["terms"])), [f"s{n}" for n in plan["slopes"]]
        results = [*values, *slopes, *names("k", len(plan["couplings"])), *names("p", len(plan["inner"]))]
        moved = ", ".join(f"x_{label(d)}" for d in self.base)
        lines = [
            f"@kernel\ndef stem_{name}(t, {bases(self.shape)}, d, x, {moved}):",
            f"    ({', '.join(results)},) = at_root({loads})",
            *(f"    z{k}_{label(d)} = {text}" for (k, d), text in self.inner_terms.items()),
        ]
        signs = names("n", len(plan["sign_terms"]))
        if signs:
            arguments = ", ".join(["x", *(load(self.shape, use, self.order) for use in plan["sign_stem"])])
            lines.append(f"    ({', '.join(signs)},) = signs({arguments})")
        lines.append(f"    return ({', '.join([*values, *signs, *self.stem_terms.values()])},)")
        return "\n".join(lines) + "\n"

    @cached_property
    def gradient(self) -> dict[tuple[Dimension, int], str]:
        """Coefficient of each monomial in the total derivative of each noise dimension, in names of the stem."""
        plan, prefix = self.plan, self.prefix
        found: dict[tuple[Dimension, int], list[str]] = {}
        for dimension, n in self.stem_terms:
            m, row = plan["terms"][n]
            found.setdefault((dimension, m), []).append(f"{prefix}e_{label(dimension)}_{n} * {prefix}w{row}")
        last = [d for d in self.shape.dimensions([self.shape.minimal]) if d[1] == "s"]
        for dimension in [*self.base, *last]:
            for n, (m, row) in enumerate(plan["terms"]):
                for v, use in enumerate(plan["row_last"]):
                    noise = noise_load(self.shape, use, self.order, dimension)
                    slope = slope_of_monomial(plan["row_monomials"][row], v, self.row_last)
                    if noise is not None and slope is not None:
                        found.setdefault((dimension, m), []).append(f"{prefix}a{n} * {slope} * {noise}")
        return {key: " + ".join(sums) for key, sums in found.items()}

    @property
    def names(self) -> list[str]:
        """Names of what is computed for a row: the value's coefficients, then those of its total derivative."""
        values = [f"{self.prefix}v{m}" for m in value_monomials(self.shape)]
        values += [f"{self.prefix}b{r}_{m}" for r, m in sign_monomials(self.shape)]
        return values + [f"{self.prefix}g_{label(d)}_{m}" for d, m in self.gradient]

    @property
    def lines(self) -> list[str]:
        """Statements that make them from the stem and the last source point d."""
        plan, prefix = self.plan, self.prefix
        powers_of_rows = enumerate(plan["row_monomials"])
        lines = [f"{prefix}w{k} = {monomial_text(powers, self.row_last)}" for k, powers in powers_of_rows]
        for m in value_monomials(self.shape):
            sums = [f"{prefix}a{n} * {prefix}w{row}" for n, (at, row) in enumerate(plan["terms"]) if at == m]
            lines.append(f"{prefix}v{m} = {' + '.join(sums)}")
        for r, m in sign_monomials(self.shape):
            terms = enumerate(plan["sign_terms"])
            sums = [f"{prefix}n{n} * {prefix}w{row}" for n, (q, at, row) in terms if (q, at) == (r, m)]
            lines.append(f"{prefix}b{r}_{m} = {' + '.join(sums)}")
        for (dimension, m), text in self.gradient.items():
            lines.append(f"{prefix}g_{label(dimension)}_{m} = {text}")
        return lines

    @property
    def sign_lines(self) -> list[str]:
        """Statements for the quantities that must be positive, at the last target point."""
        lines = []
        for r in range(conditions(self.shape)):
            held = [m for q, m in sign_monomials(self.shape) if q == r]
            lines.append(
                f"{self.prefix}o{r} = {' + '.join(f'{self.prefix}b{r}_{m} * {self.prefix}m{m}' for m in held)}"
            )
        return lines

    def slope(self, variable: int, variables: list[str]) -> str:
        """Derivative of Σ v_m m_m in one of the last quantities."""
        terms = []
        for m in value_monomials(self.shape):
            slope = slope_of_monomial(self.plan["monomials"][m], variable, variables)
            if slope is not None:
                terms.append(f"{self.prefix}v{m}" if slope == "1.0" else f"{self.prefix}v{m} * {slope}")
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

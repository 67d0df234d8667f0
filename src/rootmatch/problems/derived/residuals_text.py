"""Text of a derived problem's edge and slab kernels; see `text` for the words used."""

from __future__ import annotations

from functools import cached_property

from rootmatch.problems.derived.constraints_text import Constraints
from rootmatch.problems.derived.rows_text import Rows, merge_lines
from rootmatch.problems.derived.templates import ALONE, JOINT, NORMALISED, RESULTANT, fill_template
from rootmatch.problems.derived.text import (
    bases,
    coefficient_names,
    label,
    load,
    monomial_text,
    names,
    polynomial_text,
    state_text,
    suffix,
)


class Residuals(Constraints):
    """Composes the text of all kernels of one problem; parameters as of `Constraints`."""

    @cached_property
    def text(self) -> str:
        """All functions; composing them takes a tenth of a second."""
        parts = [polynomial_text(self.shape, order) for order in self._root_orders()]
        parts += [state_text(self.shape, order, self.interval) for order in self._root_orders()]
        parts += [self.distance_text(order) for order in self._root_orders()[1:]]
        parts += [self.near.stem_text("near"), self.near_text(), self.normalised_text()]
        if len(self.orders) > 1:
            parts += [self.each[order].stem_text(suffix(order)[1:]) for order in self.sweeping]
            parts += [self.bound_text(order) for order in self.bound]
            parts += [self.together_text(), self.joint_text()]
        else:
            parts.append(ALONE)
        parts += [self.resultant_text(kind) for kind in ("qr", "both", "svd")]
        return "\n\n".join(parts)

    def normalised_text(self) -> str:
        """Edge and slab kernels of `Normalised`."""
        base = bases(self.shape)
        order = suffix(self.first)
        hoisted = ", ".join(self.near.names)
        _, entries = self._form()
        forms = names("f", len(entries))
        views = self.near_rows.lines
        near = ", ".join([hoisted, *forms, *(f"r{k}[k]" for k in range(len(views)))])
        stem = ", ".join(self.near.stem_names)
        responses = ", ".join(f"x_{label(d)}" for d in self.near.base)
        core = [
            f"good, {', '.join(self.moved)} = state{order}(t, {base}, {coefficient_names(self.shape.degree)}, x)",
            "if not good:",
            "    continue",
            *merge_lines(self.shape, self.merged_near),
        ]
        hoist = self.near.lines
        (hoist if self._is_stem_in_row() else core).insert(
            0 if self._is_stem_in_row() else len(core), f"({stem},) = stem_near(t, {base}, d, x, {responses})"
        )
        if entries:
            hoist.append(f"({', '.join(forms)},) = form({hoisted})")
        return fill_template(
            NORMALISED,
            {
                "BASES": base,
                "FIRST": order,
                "C": coefficient_names(self.shape.degree),
                "VIEWS": views,
                "CORE": core,
                "HOIST": hoist,
                "KIND": "normalised",
                "SQUARE": f"near({near})",
                "UNPACK": self._unpacking_lines(),
                "PERMUTED": self._permuted_arguments(),
            },
        )

    def _is_stem_in_row(self) -> bool:
        """Whether the stem needs the last source point, because it is no polynomial in its quantities."""
        return any(self.m - 1 in slots for _, _, slots in self.shape.plan["stem"])

    def _unpacking_lines(self) -> list[str]:
        return [f"{letter}{k} = {letter}[{k}]" for letter in "ij" for k in range(self.m)]

    def _permuted_arguments(self) -> str:
        return ", ".join([*(f"i[o[{k}]]" for k in range(self.m)), *(f"j[o[{k}]]" for k in range(self.m))]) + (
            f", i[o[{self.m}]], j[o[{self.m}]]"
        )

    def joint_text(self) -> str:
        """Edge and slab kernels of `Joint`."""
        base = bases(self.shape)
        shared = bool(self.shape.plan["shared"])
        find: list[str] = []
        core: list[str] = []
        moved: dict[tuple[int, ...], list[str]] = {self.first: self.moved}
        x_of = {self.first: "x"}
        coefficients = coefficient_names(self.shape.degree)
        core += [
            f"good, {', '.join(self.moved)} = state{suffix(self.first)}(t, {base}, {coefficients}, x)",
            "if not good:",
            "    continue",
            *merge_lines(self.shape, self.merged),
        ]
        for number, order in enumerate(self._root_orders()[1:] if shared else ()):
            others = coefficient_names(self.shape.degree, f"y{number}_c")
            find.append(f"{others} = polynomial{suffix(order)}(t, {base})")
            find.append(f"others{number} = find_roots({others})")
            moved[order] = [f"y{number}_{name}" for name in self.moved]
            x_of[order] = f"y{number}"
            core += [
                f"y{number} = others{number}[0]",
                "best = math.inf",
                f"for other in others{number}:",
                f"    far = distance{suffix(order)}(t, {base}, x, other)",
                "    if far < best:",
                "        best = far",
                f"        y{number} = other",
                f"good, {', '.join(moved[order])} = state{suffix(order)}(t, {base}, {others}, y{number})",
                "if not good:",
                "    continue",
            ]
        hoist: list[str] = []
        arguments: list[str] = []
        for c, order in enumerate(self.orders):
            at = self.root_order(order)
            head = "" if at == self.first else moved[at][0].removesuffix(self.moved[0])
            responses = ", ".join(f"{head}x_{label(d)}" for d in self.base)
            if order in self.bound:
                results = [f"c{c}_f", *(f"c{c}_w_{label(d)}" for d in self.base)]
                core.append(f"({', '.join(results)},) = bound{suffix(order)}(t, {base}, {x_of[at]}, {responses})")
                arguments += results
                continue
            swept = self.each[order]
            stem = ", ".join(swept.stem_names)
            line = f"({stem},) = stem{suffix(order)}(t, {base}, d, {x_of[at]}, {responses})"
            (hoist if self._is_stem_in_row() else core).append(line)
            hoist += swept.lines
            arguments += swept.names
        views = self.together_rows.lines
        together = ", ".join([*arguments, *(f"r{k}[k]" for k in range(len(views)))])
        return fill_template(
            JOINT,
            {
                "BASES": base,
                "FIRST": suffix(self.first),
                "C": coefficient_names(self.shape.degree),
                "FIND": find,
                "VIEWS": views,
                "CORE": core,
                "HOIST": hoist,
                "SQUARE": f"together({together})",
                "UNPACK": self._unpacking_lines(),
                "LAST": str(self.m),
            },
        )

    def resultant_text(self, kind: str) -> str:
        """Edge and slab kernels of a residual that compares two polynomials alone."""
        shape, plan = self.shape, self.shape.plan
        degree = shape.degree
        first = ", ".join(load(shape, use, self.first) for use in plan["arguments"])
        second = ", ".join(load(shape, use, self.swept) for use in plan["arguments"])
        p, q = coefficient_names(degree, "p"), coefficient_names(degree, "q")
        rows = Rows(shape)
        variables = [rows.at(load(shape, use, self.swept)) for use in plan["last"]]
        hoisted = names("h", len(plan["row"]))
        loads = ", ".join(load(shape, use, self.swept) for use in plan["hoisted"])
        sums: dict[int, list[str]] = {power: [] for power in range(degree + 1)}
        at = {view: f"{view}[k]" for view in variables}
        for name, (power, m) in zip(hoisted, plan["row"], strict=True):
            product = monomial_text(plan["monomials"][m], [at[v] for v in variables])
            sums[power].append(name if product == "1.0" else f"{name} * {product}")
        powers = [f"q{power} = {' + '.join(terms) or '0.0'}" for power, terms in sums.items()]
        return fill_template(
            RESULTANT,
            {
                "KIND": kind,
                "BASES": bases(shape),
                "P": p,
                "Q": q,
                "FIRST": first,
                "SECOND": second,
                "HOISTED": ", ".join(hoisted),
                "LOADS": loads,
                "VIEWS": rows.lines,
                "POWERS": powers,
                "LARGEST": f"max({', '.join(f'abs(p{k})' for k in range(degree + 1))})",
                "UNITS": [f"p{k} *= one" for k in range(degree + 1)],
                "UNITS_OF_BOTH": [f"q{k} *= one" for k in range(degree + 1)],
                "UNITS_OF_ROW": [f"{name} *= one" for name in hoisted],
                "UNPACK": self._unpacking_lines(),
                "PERMUTED": self._permuted_arguments(),
                "LAST": str(self.m),
            },
        )

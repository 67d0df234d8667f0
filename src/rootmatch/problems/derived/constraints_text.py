"""Text of a derived problem's constraints at one target point, with their covariance; see `text` for the words used."""

from __future__ import annotations

from rootmatch.problems.derived.rows_text import Rows, Swept, base_dimensions, passive_places
from rootmatch.problems.derived.text import (
    Dimension,
    Shape,
    bases,
    coefficient_names,
    conditions,
    horner_lines,
    label,
    load,
    monomial_text,
    names,
    noise_load,
    noise_terms,
    root_order,
    suffix,
    value_monomials,
)


class Constraints:
    """Composes the text for one problem.

    Parameters
    ----------
    shape : Shape
    orders : sequence of tuple of int
        Places of the minimal sets whose polynomials are the constraints of ``joint``, at roots of the first
        correspondences' own polynomial; those without the last place bind the minimal set itself.
    interval : (float, float), optional
        Where the shared variable may lie.
    """

    def __init__(
        self, shape: Shape, orders: tuple[tuple[int, ...], ...], interval: tuple[float, float] | None = None
    ) -> None:
        self.shape = shape
        self.interval = interval
        self.m = shape.minimal
        self.first = tuple(range(self.m))
        self.swept = (*range(self.m - 1), self.m)
        self.orders = orders
        self.bound = [order for order in orders if self.m not in order]
        self.sweeping = [order for order in orders if self.m in order]
        self.moved = [f"x_{label(d)}" for d in shape.dimensions(range(self.m))]
        shared = bool(shape.plan["shared"])
        self.merged_near = passive_places(shape, [self.swept], False)
        self.merged = passive_places(shape, orders, shared)
        self.base = base_dimensions(shape, self.merged)
        self.near = Swept(shape, self.swept, base_dimensions(shape, self.merged_near))
        self.each = {o: Swept(shape, o, self.base, f"c{c}_") for c, o in enumerate(orders) if o in self.sweeping}

    def root_order(self, order: tuple[int, ...]) -> tuple[int, ...]:
        """Order of the first correspondences whose root belongs to a constraint.

        Its own where the unknown belongs to some of the correspondences, the first one where it belongs to all.
        """
        return root_order(order) if self.shape.plan["shared"] else self.first

    def _root_orders(self) -> list[tuple[int, ...]]:
        return list(dict.fromkeys([self.first, *(self.root_order(order) for order in self.orders)]))

    def gradient(self, swept: Swept, rows: Rows, last: list[str]) -> dict[Dimension, str]:
        """Total derivative at the last target point, one expression for each noise dimension.

        ``last`` names quantities of the last target point.
        """
        shape, prefix = self.shape, swept.prefix
        found: dict[Dimension, list[str]] = {}
        for dimension, m in swept.gradient:
            found.setdefault(dimension, []).append(f"{prefix}g_{label(dimension)}_{m} * {prefix}m{m}")
        own = [(self.m, "t", axis) for axis in range(shape.target_noise)]
        for dimension in [*swept.base, *own]:
            for v, use in enumerate(shape.plan["last"]):
                noise = noise_load(shape, use, swept.order, dimension)
                if noise is not None and swept.slope(v, last) != "0.0":
                    found.setdefault(dimension, []).append(f"{prefix}q{v}_slope * {rows.at(noise)}")
        return {dimension: " + ".join(terms) for dimension, terms in found.items()}

    def value_lines(self, swept: Swept, rows: Rows) -> tuple[list[str], list[str]]:
        """Statements for monomials, value and slopes in the last quantities; names of these."""
        plan, prefix = self.shape.plan, swept.prefix
        variables = [rows.at(load(self.shape, use, swept.order)) for use in plan["last"]]
        lines = [f"{prefix}m{m} = {monomial_text(p, variables)}" for m, p in enumerate(plan["monomials"])]
        total = " + ".join(f"{prefix}v{m} * {prefix}m{m}" for m in value_monomials(self.shape))
        lines.append(f"{prefix}f = {total}")
        for v in range(len(variables)):
            lines.append(f"{prefix}q{v}_slope = {swept.slope(v, variables)}")
        return lines, variables

    def _direct(self) -> list[Dimension]:
        """Noise dimensions of the minimal set that the last target's quantities depend on themselves."""
        uses = self.shape.plan["last"]
        return [
            d for d in self.near.base if any(noise_load(self.shape, use, self.swept, d) is not None for use in uses)
        ]

    def _form(self) -> tuple[list[Dimension], list[tuple[int, int]]]:
        """Dimensions whose squares are summed before the loop as one form in the monomials, and its entries."""
        direct = self._direct()
        found = dict.fromkeys(d for d, _ in self.near.gradient)
        rest = [d for d in found if d not in direct]
        used = value_monomials(self.shape)
        count = len(used)
        if len(rest) * (count + 1) <= count * (count + 3) // 2:
            return [], []
        return rest, [(a, b) for a in used for b in used if a <= b]

    def near_text(self) -> str:
        """``form(h…) → f…`` and ``near(h…, f…, r…) → squared residual`` of the first constraint alone."""
        rows = Rows(self.shape)
        lines, variables = self.value_lines(self.near, rows)
        gradient = self.gradient(self.near, rows, variables)
        rest, entries = self._form()
        terms = self.near.gradient
        forms = []
        for a, b in entries:
            products = [f"g_{label(d)}_{a} * g_{label(d)}_{b}" for d in rest if (d, a) in terms and (d, b) in terms]
            forms.append(("" if a == b else "2.0 * ") + f"({' + '.join(products) or '0.0'})")
        own = [d for d in gradient if d[0] == self.m and d[1] == "t"]
        summed = [d for d in gradient if d not in rest and d not in own]
        lines += [f"w_{label(d)} = {gradient[d]}" for d in (*own, *summed)]
        lines.append(f"own = {' + '.join(f'w_{label(d)} * w_{label(d)}' for d in own) or '0.0'}")
        # by rows, so that each monomial is multiplied once with what goes with it
        by_row: dict[int, list[str]] = {}
        for place, (a, b) in enumerate(entries):
            by_row.setdefault(a, []).append(f"f{place} * m{b}")
        parts = [f"m{a} * ({' + '.join(products)})" for a, products in by_row.items()]
        parts += [f"w_{label(d)} * w_{label(d)}" for d in summed]
        lines.append(f"variance = own + {' + '.join(parts) or '0.0'}")
        lines.append("ratio = f * f / variance")
        lines += self.near.sign_lines
        clear = "ratio >= 0.0 and ratio < BIG" + (" and variance < VAGUE * own" if own else "")
        clear += "".join(f" and o{r} > 0.0" for r in range(conditions(self.shape)))
        lines.append(f"return ratio if {clear} else BIG")
        self.near_rows = rows
        hoisted = ", ".join(self.near.names)
        arguments = ", ".join([hoisted, *names("f", len(entries)), *names("r", len(rows.views))])
        made = f"@scalar\ndef form({hoisted}):\n    return ({', '.join(forms)},)\n\n\n" if entries else ""
        return made + f"@scalar\ndef near({arguments}):\n    " + "\n    ".join(lines) + "\n"

    def bound_text(self, order: tuple[int, ...]) -> str:
        """``bound_…(t, i…, j…, x, dx…) → f, g…`` of a constraint that binds the minimal set itself."""
        shape, plan = self.shape, self.shape.plan
        loads = ", ".join(load(shape, use, order) for use in plan["arguments"])
        partials = names("p", len(plan["noisy"]))
        sums = [" + ".join([f"slope * x_{label(d)}", *noise_terms(shape, partials, order, d)]) for d in self.base]
        moved = ", ".join(f"x_{label(d)}" for d in self.base)
        return (
            f"@kernel\ndef bound{suffix(order)}(t, {bases(shape)}, x, {moved}):\n"
            + f"    {coefficient_names(shape.degree)} = polynomial({loads})\n"
            + "".join(f"    {line}\n" for line in horner_lines(shape.degree))
            + f"    ({', '.join(partials)},) = partials(x, {loads})\n"
            + f"    return value, {', '.join(sums)}\n"
        )

    def together_text(self) -> str:
        """``together(h…, r…) → χ²`` of all constraints."""
        rows = Rows(self.shape)
        lines: list[str] = []
        gradients: list[dict[Dimension, str]] = []
        arguments: list[str] = []
        vague = []
        for c, order in enumerate(self.orders):
            prefix = f"c{c}_"
            if order in self.bound:
                dimensions = self.base
                arguments += [f"{prefix}f", *(f"{prefix}w_{label(d)}" for d in dimensions)]
                gradients.append({d: f"{prefix}w_{label(d)}" for d in dimensions})
                continue
            swept = self.each[order]
            made, variables = self.value_lines(swept, rows)
            lines += made
            arguments += swept.names
            gradient = self.gradient(swept, rows, variables)
            lines += [f"{prefix}w_{label(d)} = {text}" for d, text in gradient.items()]
            gradients.append({d: f"{prefix}w_{label(d)}" for d in gradient})
            own = [f"{name} * {name}" for d, name in gradients[-1].items() if d[0] == self.m and d[1] == "t"]
            lines += swept.sign_lines
            vague += [f"{prefix}o{r} > 0.0" for r in range(conditions(self.shape))]
            if own:
                vague.append(f"s{c}_{c} < VAGUE * ({' + '.join(own)})")
        count = len(self.orders)
        for a in range(count):
            for b in range(a, count):
                products = [f"{name} * {gradients[b][d]}" for d, name in gradients[a].items() if d in gradients[b]]
                lines.append(f"s{a}_{b} = {' + '.join(products)}")
        lines.append(f"clear = {' and '.join(vague) or 'True'}")
        lines.append("total = 0.0")
        # Cholesky's elimination, unrolled
        for a in range(count):
            lines.append(f"total += c{a}_f * c{a}_f / s{a}_{a}")
            for b in range(a + 1, count):
                lines.append(f"l{b} = s{a}_{b} / s{a}_{a}")
                lines.append(f"c{b}_f = c{b}_f - l{b} * c{a}_f")
                lines += [f"s{b}_{e} = s{b}_{e} - l{b} * s{a}_{e}" for e in range(b, count)]
        lines.append("return total if clear and total >= 0.0 and total < BIG else BIG")
        self.together_rows = rows
        parameters = ", ".join([*arguments, *names("r", len(rows.views))])
        return f"@scalar\ndef together({parameters}):\n    " + "\n    ".join(lines) + "\n"

    def distance_text(self, order: tuple[int, ...]) -> str:
        """``distance_…(t, i…, j…, x, y) → how far y is from the root in this order that goes with the root x``."""
        plan = self.shape.plan
        count = plan["relations"].get(order, 0)
        loads = ", ".join(load(self.shape, use, self.first) for use in plan["relation_arguments"].get(order, ()))
        lines = [f"@kernel\ndef distance{suffix(order)}(t, {bases(self.shape)}, x, y):"]
        if not count:
            return lines[0] + "\n    return 0.0\n"
        results = ", ".join(f"e{k}, s{k}" for k in range(count))
        lines.append(f"    {results} = relation{suffix(order)}(x, y, {loads})")
        lines.append(f"    return {' + '.join(f'e{k} * e{k} / (s{k} * s{k} + 1e-300)' for k in range(count))}")
        return "\n".join(lines) + "\n"

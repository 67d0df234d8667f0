"""The formulas of a generated module on arrays of points: tables for kernels, and values for checks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from rootmatch.arrays import Floats
from rootmatch.deadline import checkpoint
from rootmatch.problems.derived.measurements import Measurement

CELLS = 16_384
"""Pairs of which a quantity and its derivatives are computed between two looks at the time: some milliseconds."""


@dataclass(frozen=True)
class Evaluator:
    """A generated module together with what is measured."""

    plan: dict[str, Any]
    functions: dict[str, Callable[..., Any]]
    """Of `rootmatch.problems.derived.store.Generated`."""
    source: Measurement
    target: Measurement

    def used(self, kind: str) -> list[int]:
        """Numbers of the quantities of a class that are generated."""
        return [k for k in range(self.plan["leaves"][kind]) if f"leaf_{kind}{k}" in self.functions]

    def leaf(self, kind: str, number: int, *coordinates: Floats) -> Floats:
        """One quantity of points given by coordinates (…, c), one array for each point."""
        values = [x[..., k] for x in coordinates for k in range(x.shape[-1])]
        with np.errstate(all="ignore"):
            (result,) = self.functions[f"leaf_{kind}{number}"](*values)
        return np.broadcast_to(np.asarray(result, dtype=float), np.broadcast_shapes(*(v.shape for v in values)))

    def leaf_noise(self, kind: str, number: int, coordinates: list[Floats], spreads: list[Floats]) -> list[Floats]:
        """Derivatives of a leaf in unit noise, (…, D) for each point, from coordinates (…, c) and spreads (…, c, D)."""
        values = [x[..., k] for x in coordinates for k in range(x.shape[-1])]
        shape = np.broadcast_shapes(*(v.shape for v in values))
        with np.errstate(all="ignore"):
            partials = self.functions[f"leaf_{kind}{number}_partials"](*values)
        size = coordinates[0].shape[-1]
        out = []
        for point, spread in enumerate(spreads):
            stacked = [np.broadcast_to(np.asarray(p, dtype=float), shape) for p in partials[point * size :][:size]]
            out.append(np.einsum("...c,...cd->...d", np.stack(stacked, axis=-1), spread))
        return out

    def table(self, kind: str, coordinates: Floats) -> Floats:
        """All quantities of a class, (count, n) or (count, n, n), of coordinates (n, c)."""
        points = len(kind)
        if not self.used(kind):
            return np.zeros((0, *(1,) * points))
        out = np.zeros((self.plan["leaves"][kind], *(len(coordinates),) * points))
        for rows, some in _pieces(kind, coordinates):
            for k in self.used(kind):
                checkpoint()
                out[k, rows] = self.leaf(kind, k, *some)
        return out

    def noise_table(self, kind: str, coordinates: Floats, spread: Floats) -> Floats:
        """Their derivatives in unit noise; see `rootmatch.problems.derived.tables.DerivedTables` for the layout."""
        count, points, axes = self.plan["leaves"][kind], len(kind), spread.shape[-1]
        if not self.used(kind) or not axes:
            return np.zeros((0, *(1,) * points))
        out = np.zeros((count, points, axes, *(len(coordinates),) * points))
        for (rows, some), (_, spreads) in zip(_pieces(kind, coordinates), _pieces(kind, spread), strict=True):
            for k in self.used(kind):
                checkpoint()
                for end, part in enumerate(self.leaf_noise(kind, k, some, spreads)):
                    out[k, end, :, rows] = np.moveaxis(part, -1, 0)
        return out.reshape(count * points * axes, *out.shape[3:])

    def arguments(self, source: Floats, target: Floats) -> list[Floats]:
        """Arguments of the formulas for minimal sets of points (E, m, dimension)."""
        measured = {"s": self.source.measure(source), "t": self.target.measure(target)}
        return [
            self.leaf(kind, number, *(measured[kind[0]][:, slot] for slot in slots))
            for kind, number, slots in self.plan["arguments"]
        ]

    def coefficients(self, source: Floats, target: Floats) -> Floats:
        """Coefficients (E, k + 1), highest degree first, of minimal sets of points (E, m, dimension)."""
        values = self.functions["polynomial"](*self.arguments(source, target))
        return np.stack(np.broadcast_arrays(*values, np.zeros(len(source)))[:-1], axis=-1)

    def partials(self, x: Floats, source: Floats, target: Floats, sigma: float = 1.0) -> tuple[Floats, Floats, Floats]:
        """Value (E,) and slope (E,) at x (E,), and derivatives (E, m, D) in unit noise, the source's axes first."""
        arguments = self.arguments(source, target)
        gradient = [np.broadcast_to(r, x.shape) for r in self.functions["partials"](x, *arguments)]
        value, slope = np.zeros(len(x)), np.zeros(len(x))
        for coefficient in self.functions["polynomial"](*arguments):
            slope = slope * x + value
            value = value * x + coefficient
        measured = {"s": self.source.measure(source), "t": self.target.measure(target)}
        axes = self.source.noise_dimensions
        out = np.zeros((len(x), self.plan["minimal"], axes + self.target.noise_dimensions))
        spreads = {}
        for side, what, points in (("s", self.source, source), ("t", self.target, target)):
            flat = points.reshape(-1, points.shape[-1])
            spread = what.spread(flat, np.full(len(flat), sigma))
            spreads[side] = spread.reshape(*points.shape[:2], *spread.shape[1:])
        for derivative, place in zip(gradient, self.plan["noisy"], strict=True):
            kind, number, slots = self.plan["arguments"][place]
            side = kind[0]
            parts = self.leaf_noise(
                kind, number, [measured[side][:, slot] for slot in slots], [spreads[side][:, slot] for slot in slots]
            )
            columns = slice(0, axes) if side == "s" else slice(axes, None)
            for slot, part in zip(slots, parts, strict=True):
                out[:, slot, columns] += derivative[:, None] * part
        return value, slope, out


def _pieces(kind: str, values: Floats) -> Iterator[tuple[slice, list[Floats]]]:
    """Rows of a table of points or pairs that are computed together, at least one, and the values (n, …) of each."""
    if len(kind) == 1:
        yield slice(None), [values]
        return
    size = max(CELLS // max(len(values), 1), 1)
    for first in range(0, len(values), size):
        rows = slice(first, first + size)
        yield rows, [values[rows, None], values[None, :]]

"""Random exact hyper-edges of a stated problem: from the user's sampler, or solved for numerically."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import sympy as sp
from scipy.optimize import least_squares

from rootmatch.arrays import Floats
from rootmatch.derivation.leaves import COMMON, Expr
from rootmatch.derivation.statement import Statement
from rootmatch.errors import InputError, RootmatchError

Sampler = Callable[[np.random.Generator], Any]
ATTEMPTS = 60
"""Starts of the numerical solution for one instance."""
STEP = float(np.sqrt(np.finfo(float).eps))
"""Step of finite differences; relative for values above 1."""
DIFFERENCE, DEPENDENT, HOLDS = 1e-6, 1e-6, 1e-9
"""Step of central differences of what is scaled to order 1, singular value of unit rows that is their error, and the
value of an equation, relative to its terms, that is rounding."""
STARTS = 6
"""Starts of the unknowns of an instance whose constraints are counted."""
NEAR, FULL_STEPS, EXACT = 1e-4, 4, 1e-11
"""Gradient at which full steps begin, how many at most, and the greatest value of an equation that holds."""


class Instance(NamedTuple):
    """One exact hyper-edge: points (m + 1, dimension) as a caller gives them, and the shared variable if known."""

    source: Floats
    target: Floats
    shared: float | None


def sample_instance(sample: Sampler, statement: Statement, rng: np.random.Generator) -> Instance:
    """An instance from the user's sampler."""
    given = tuple(sample(rng))
    if len(given) not in (2, 3):
        raise InputError("sample: it must return source, target and optionally the shared variable's value")
    count = statement.minimal + 1
    points = []
    for name, array, what in (("source", given[0], statement.source), ("target", given[1], statement.target)):
        array = np.asarray(array, dtype=float)
        if array.ndim != 2 or len(array) < count or array.shape[1] != what.dimension or not np.all(np.isfinite(array)):
            raise InputError(
                f"sample: {name} of shape {array.shape} returned; ({count}, {what.dimension}) finite numbers expected, "
                "row i of the one matching row i of the other"
            )
        points.append(array[:count])
    return Instance(points[0], points[1], float(given[2]) if len(given) == 3 else None)


class Solver:
    """Solves for exact hyper-edges: random source points, then target points and unknowns that satisfy all equations.

    All minimal sets of the hyper-edge must hold at once. Unknowns that belong to some of the correspondences (a depth)
    are one for each choice of those, the others (a pose) are the same in all.
    """

    def __init__(self, statement: Statement) -> None:
        self.statement = statement
        m = statement.minimal
        points: dict[str, list[Any]] = {}
        slot_of: dict[Expr, int] = {}
        for side, what in (("s", statement.source), ("t", statement.target)):
            points[side] = [sp.Matrix([sp.Symbol(n, real=True) for n in what.names(side, k)]) for k in range(m + 1)]
            own = what.coordinates - what.common
            for slot, column in enumerate(points[side]):
                slot_of |= {symbol: slot if k < own else COMMON for k, symbol in enumerate(column)}
        base = statement.build(points["s"][:m], points["t"][:m])
        self.places = statement.places_of_unknowns(base, slot_of)
        equations: dict[Expr, None] = {}
        self.of_first = 0
        """Number of equations of the first minimal set."""
        for chosen in combinations(range(m + 1), m):
            built = statement.build([points["s"][k] for k in chosen], [points["t"][k] for k in chosen])
            swap = {symbol: self.copy(symbol, chosen) for symbol in (*statement.unknowns, statement.shared)}
            equations |= dict.fromkeys(e.xreplace(swap) for e in built)
            self.of_first = self.of_first or len(equations)
        every = [symbol for group in points.values() for column in group for symbol in column]
        measured = list(dict.fromkeys(every))
        self.first_places = [every.index(symbol) for symbol in measured]
        self.unknowns = sorted({s for e in equations for s in e.free_symbols if s not in slot_of}, key=str)
        self.shared = self.unknowns.index(self.copy(statement.shared, tuple(range(m))))
        expressions = list(equations)
        zero = {s: 0 for s in self.unknowns if not str(s).startswith(f"{statement.shared.name}__")}
        self.homogeneous = all(e.xreplace(zero) == 0 for e in expressions) and bool(zero)
        if self.homogeneous:
            expressions.append(sum(s**2 for s in zero) - 1)
        self.function = sp.lambdify([self.unknowns, measured], expressions, "numpy", cse=True)

    def copy(self, symbol: Expr, chosen: tuple[int, ...]) -> Expr:
        """The copy of an unknown in the minimal set of the chosen correspondences."""
        places = self.places[symbol]
        base = symbol.name.split("__")[0] if symbol in self.statement.places_of_copies else symbol.name
        belongs = places if len(places) < self.statement.minimal else ()
        return sp.Symbol("__".join([base, *(str(chosen[k]) for k in belongs)]) + "__")

    def solve(self, rng: np.random.Generator, interval: tuple[float, float] | None) -> Instance:
        """One exact instance."""
        statement = self.statement
        count = statement.minimal + 1
        size = len(self.unknowns)
        for _ in range(ATTEMPTS):
            source = statement.source.sample(rng, count)
            start = statement.target.sample(rng, count)
            unit = np.abs(start).mean()

            def residuals(trials: Floats, source: Floats = source, start: Floats = start, unit: float = unit) -> Floats:
                target = start + trials[:, size:].reshape(-1, *start.shape) * unit
                return self.values(trials[:, :size], source[None], target)

            guess = np.concatenate([rng.uniform(0.3, 2.0, size), np.zeros(start.size)])
            v, values, jacobian = _solution(residuals, guess)
            x = float(v[self.shared])
            inside = interval is None or interval[0] < x < interval[1]
            if np.abs(values).max() < EXACT and inside and abs(x) < 30.0 and self._is_isolated(v[:size], jacobian):
                return Instance(source, start + v[size:].reshape(start.shape) * unit, x)
        raise RootmatchError(
            "check: no exact instance was found numerically; give sample=, a function of a random generator that "
            f"returns {count} true correspondences (source, target)"
        )

    def values(self, unknowns: Floats, source: Floats, target: Floats) -> Floats:
        """Values (T, e) of the equations at unknowns (T, k) and points (T, m + 1, dimension), or one set of them."""
        trials = len(unknowns)
        sides = (self.statement.source.measure(source), self.statement.target.measure(target))
        measured = [np.broadcast_to(x.reshape(len(x), -1), (trials, x[0].size)) for x in sides]
        values = self.function(unknowns.T, np.concatenate(measured, axis=1)[:, self.first_places].T)
        return np.array(np.broadcast_arrays(*values, np.empty(trials))[:-1], dtype=float).T

    def constraints(self, case: Instance, rng: np.random.Generator) -> list[tuple[int, int]]:
        """How many independent constraints the equations put on the noisy points of a minimal set and a hyper-edge.

        As many as equations are independent in unknowns and points together, less those that are so in the unknowns
        alone. Of each solution for the unknowns that is found: where copies of one quantity, such as a depth in
        several minimal sets, are at different roots, equations that say the same there say more.
        """
        found = []
        for attempt in range(STARTS):
            # copies of one quantity that start together mostly stay so
            apart = 1.0 if attempt % 2 else 0.01
            guess = rng.normal() * (1.0 - apart) + apart * rng.normal(size=len(self.unknowns))
            v, values, jacobian = _solution(
                lambda trials: self.values(trials, case.source[None], case.target[None]), guess
            )
            sizes = np.abs(jacobian) @ np.abs(v)
            if np.all(np.abs(values) <= HOLDS * sizes) and np.abs(v).min() > HOLDS * np.abs(v).max():
                slopes = self._slopes(v, case)
                parts = slopes[: self.of_first], slopes
                ranks = [[_rank(part), _rank(part[:, : len(v)])] for part in parts]
                found.append((ranks[0][0] - ranks[0][1], ranks[1][0] - ranks[1][1]))
        return found

    def _slopes(self, v: Floats, case: Instance) -> Floats:
        """Unit derivatives (e, k + noisy coordinates) of the equations, in unknowns and points of order 1."""
        one, size = (case.source[None], case.target[None]), len(v)
        noisy = [k for k, what in enumerate((self.statement.source, self.statement.target)) if what.noise_dimensions]
        scale = np.concatenate([np.abs(v), *(np.full(one[k].size, np.ptp(one[k])) for k in noisy)])

        def moved(trials: Floats) -> Floats:
            points, begin = list(one), size
            for k in noisy:
                shifts = trials[:, begin : begin + one[k].size]
                points[k] = one[k] + shifts.reshape(-1, *one[k].shape[1:])
                begin += one[k].size
            return self.values(trials[:, :size], points[0], points[1])

        z = np.concatenate([v, np.zeros(len(scale) - size)])
        steps = DIFFERENCE * np.diag(scale)
        slopes = (moved(z + steps) - moved(z - steps)).T
        unit: Floats = slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-300)
        return unit

    def _is_isolated(self, unknowns: Floats, jacobian: Floats) -> bool:
        """Whether the points determine the unknowns, and none of these is so near 0 that an equation degenerates."""
        if not np.all(np.isfinite(jacobian)):
            return False
        sizes = np.abs(unknowns)
        singular = np.linalg.svd(jacobian[:, : len(sizes)], compute_uv=False)
        return bool(sizes.max() < 1e3 and sizes.min() > 1e-2 and singular[-1] > 1e-3 * singular[0])


def _rank(rows: Floats) -> int:
    return int(np.linalg.matrix_rank(rows, tol=DEPENDENT))


def _solution(residuals: Callable[[Floats], Floats], guess: Floats) -> tuple[Floats, Floats, Floats]:
    """Where all ``residuals`` (T, e) of trials (T, k) vanish, if it goes well; their values and slopes there.

    There are more unknowns than equations, where steps within a trust region converge linearly: they lead near, and
    shortest full steps from there.
    """

    def at(v: Floats) -> Floats:
        values: Floats = residuals(v[None])[0]
        return values

    def slopes(v: Floats) -> Floats:
        # forward differences, the trials of all of them at once
        trials = np.concatenate([v[None], v + np.diag(STEP * np.copysign(np.maximum(1.0, np.abs(v)), v))])
        found = residuals(trials)
        return np.asarray((found[1:] - found[0]).T / np.diagonal(trials[1:] - v))

    found = least_squares(at, guess, slopes, xtol=1e-15, ftol=1e-15, gtol=NEAR, max_nfev=200)
    v, values, jacobian = found.x, found.fun, found.jac
    for _ in range(FULL_STEPS):
        if not (0.1 * EXACT < np.abs(values).max() < 1e-2 and np.all(np.isfinite(jacobian))):
            break
        # dependent equations leave singular values of the size of the differences' errors
        v = v - np.linalg.lstsq(jacobian, values, rcond=1e-6)[0]
        values, jacobian = at(v), slopes(v)
    return v, values, jacobian


def instances(
    statement: Statement,
    sample: Sampler | None,
    interval: tuple[float, float] | None,
    rng: np.random.Generator,
    count: int,
    solver: Solver | None = None,
) -> list[Instance]:
    """Exact hyper-edges, ``count`` of them."""
    if sample is not None:
        return [sample_instance(sample, statement, rng) for _ in range(count)]
    solver = solver or Solver(statement)
    return [solver.solve(rng, interval) for _ in range(count)]

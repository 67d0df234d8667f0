"""`derive`: a problem from SymPy equations (the extra ``symbolic``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rootmatch._version import __version__
from rootmatch.errors import InputError, RootmatchError
from rootmatch.problems.derived import store
from rootmatch.problems.derived.measurements import Bearings, Measurement, Points, Uncalibrated, check_measurement
from rootmatch.problems.derived.problem import DerivedProblem

__all__ = ["Bearings", "DerivedProblem", "Measurement", "Points", "Uncalibrated", "derive"]

CASES = 12
"""Exact hyper-edges that a new derivation is checked on."""
CASES_AGAIN = 3
"""Exact cases that a derivation read from disk is checked on."""
CASES_COUNTED = 3
"""Exact cases on which the constraints of the equations are counted."""


def derive(
    name: str,
    equations: Any = None,
    *,
    each: Any = None,
    minimal: int,
    shared: Any,
    eliminate: Sequence[Any] = (),
    local: Sequence[Any] = (),
    source: Measurement,
    target: Measurement,
    interval: tuple[float | None, float | None] | None = None,
    positive: Any = None,
    constraints: int | None = None,
    sample: Any = None,
    cached: bool = True,
) -> DerivedProblem:
    """Make a problem of the equations of a minimal set.

    The unknowns are eliminated until one polynomial in the shared variable is left; spurious factors are taken off; the
    result is checked on random exact hyper-edges; and kernels for all residuals are generated from it.

    Parameters
    ----------
    name : str
        Of the problem.
    equations : callable
        ``equations(X, u)`` returns SymPy expressions that vanish for a minimal set. ``X`` and ``u`` are lists of
        ``minimal`` column vectors with the coordinates of the source and target points, in matching order.
    each : callable
        Instead of ``equations``: ``each(X, u)`` returns those of one correspondence; they are stated for all.
    minimal : int
        Correspondences of a minimal set.
    shared : symbol
        The variable that minimal sets share: it belongs to the camera, or to their first correspondences. Angles enter
        as x = tan(θ/2). Its name is a word of small letters, as it stands in the generated code.
    eliminate : sequence of symbols
        The other unknowns.
    local : sequence of symbols
        With ``each``: unknowns of which every correspondence has its own, such as a depth.
    source, target : Measurement
        What a point gives: ``Points(3)``, ``Points(2)``, ``Bearings(camera)``, ``Uncalibrated(centre)``.
    interval : (low, high), optional
        Open interval for the shared variable, None for no bound; roots outside do not count.
    positive : callable, optional
        ``positive(X, u)`` returns expressions of a minimal set, in the shared variable and what is measured, that are
        positive for true correspondences: depths, or products of two that share an unknown sign. Roots where one is
        negative do not count, which stops most chance agreement where a hyper-edge has a single constraint.
    constraints : int, optional
        Independent constraints of a hyper-edge of ``minimal + 1`` correspondences, at most; found numerically if not
        given.
    sample : callable, optional
        ``sample(rng)`` returns the source and target points of ``minimal + 1`` true correspondences without noise, as
        they would be given to `rootmatch.match`, and perhaps the shared variable. Otherwise exact instances are solved
        for numerically.
    cached : bool
        Whether generated code is kept in, and taken from, the user's cache folder (``ROOTMATCH_CACHE_DIR``). Such a
        file is vetted and checked before it is used.

    Returns
    -------
    DerivedProblem

    Raises
    ------
    InputError
        If the statement cannot be used; the text says why.
    RootmatchError
        If the result does not hold on exact instances, or SymPy is missing.

    Examples
    --------
    A robot on a flat floor observes points twice; it has rotated by θ and translated by (tx, 0, tz)::

        x, tx, tz = sympy.symbols("x tx tz")
        R = sympy.Matrix([[1 - x**2, 0, 2 * x], [0, 1 + x**2, 0], [-2 * x, 0, 1 - x**2]])
        move = sympy.Matrix([tx, 0, tz])
        problem = rm.derive("floor", each=lambda p, q: q.dot(move.cross(R * p)), minimal=2, shared=x,
                            eliminate=[tx, tz], source=rm.Bearings(camera), target=rm.Bearings(camera))
    """
    try:
        import sympy
    except ImportError:
        raise RootmatchError("derive: SymPy is missing; install the extra: pip install 'rootmatch[symbolic]'") from None
    from rootmatch.derivation.generate import FORMAT
    from rootmatch.derivation.statement import Statement

    store.check_stem(name)
    _check_statement(
        sympy=sympy, equations=equations, each=each, minimal=minimal, shared=shared, eliminate=eliminate, local=local
    )
    statement = Statement(
        equations=each if each is not None else equations,
        each=each is not None,
        minimal=int(minimal),
        shared=shared,
        eliminate=tuple(eliminate),
        local=tuple(local),
        source=check_measurement(source, "source"),
        target=check_measurement(target, "target"),
        positive=positive,
    )
    if not statement.source.noise_dimensions + statement.target.noise_dimensions:
        raise InputError(
            "target: both sets are exact; noise must enter somewhere, for example by Points(3, noisy=True)"
        )
    limits = _interval(interval)
    symbols = _symbols(statement)
    _, built, conditions = symbols
    extra = f"{len(conditions)} {__version__} {FORMAT} {limits} {constraints} {sample is not None}"
    key = str(statement.digest([*built, *conditions], extra))
    stem = f"{name}-{key[:24]}"
    found = store.load(stem) if cached else None
    if found is not None and found.plan.get("key") == key:
        try:
            _recheck(found, statement, sample, limits)
            return DerivedProblem(name, found, statement.source, statement.target)
        except (RootmatchError, KeyError, TypeError, ValueError, IndexError):
            pass  # a file that does not hold is made anew
    generated = _derive(
        statement=statement, symbols=symbols, key=key, limits=limits, constraints=constraints, sample=sample
    )
    if cached:
        store.save(generated.text, stem)
    return DerivedProblem(name, generated, statement.source, statement.target)


def _check_statement(
    sympy: Any, equations: Any, each: Any, minimal: Any, shared: Any, eliminate: Sequence[Any], local: Sequence[Any]
) -> None:
    given = equations if each is None else each
    if (equations is None) == (each is None) or not callable(given):
        raise InputError(
            "derive: give either equations= or each=, a function of source and target points that returns expressions"
        )
    if not isinstance(minimal, int) or not 1 <= minimal <= 6:
        raise InputError(f"minimal: {minimal!r} given; give the number of correspondences of a minimal set, 1 to 6")
    for label, symbols in (("shared", [shared]), ("eliminate", eliminate), ("local", local)):
        for symbol in symbols:
            if not isinstance(symbol, sympy.Symbol):
                raise InputError(f"{label}: {symbol!r} given; SymPy symbols expected")
    named = [shared, *eliminate, *local]
    if len(set(named)) != len(named):
        raise InputError("derive: a symbol is named twice among shared, eliminate and local; name each once")
    if local and each is None:
        raise InputError("local: it goes with each=; name unknowns of a minimal set in eliminate=")


def _interval(interval: tuple[float | None, float | None] | None) -> tuple[float, float] | None:
    if interval is None:
        return None
    low, high = (
        limit if value is None else float(value) for value, limit in zip(interval, (-1e300, 1e300), strict=True)
    )
    if not low < high:
        raise InputError(f"interval: {interval} given; give the lower bound first, None for none")
    return low, high


def _symbols(statement: Any) -> tuple[Any, list[Any], list[Any]]:
    """Registry of leaves and the equations in its symbols, refused if they cannot be meant."""
    from rootmatch.derivation.leaves import Leaves

    leaves = Leaves(statement.source, statement.target, statement.minimal)
    built = statement.build(leaves.points["s"], leaves.points["t"])
    measured = {symbol for side in leaves.points.values() for column in side for symbol in column}
    conditions = statement.conditions(leaves.points["s"], leaves.points["t"])
    statement.check(measured, built, conditions)
    return leaves, built, conditions


def _recheck(found: store.Generated, statement: Any, sample: Any, limits: Any) -> None:
    from rootmatch.derivation.check import Judge
    from rootmatch.derivation.instances import instances
    from rootmatch.problems.derived.evaluator import Evaluator

    rng = np.random.default_rng(1)
    evaluator = Evaluator(found.plan, found.functions, statement.source, statement.target)
    judge = Judge(evaluator, instances(statement, sample, limits, rng, CASES_AGAIN))
    if not (judge.vanishes(judge.first) and judge.vanishes(judge.swept)):
        raise RootmatchError("check: the generated code fails the checks on exact instances")


def _derive(
    statement: Any, symbols: Any, key: str, limits: tuple[float, float] | None, constraints: int | None, sample: Any
) -> store.Generated:
    from rootmatch.derivation.check import Judge
    from rootmatch.derivation.elimination import Definitions, eliminate, make_polynomials
    from rootmatch.derivation.generate import draft
    from rootmatch.derivation.instances import Solver, instances
    from rootmatch.derivation.relations import relation_texts
    from rootmatch.derivation.spurious import remove_spurious
    from rootmatch.problems.derived.evaluator import Evaluator
    from rootmatch.problems.derived.text import root_order

    rng = np.random.default_rng(0)
    x = statement.shared
    leaves, built, conditions = symbols
    unknowns = statement.unknowns
    everything = {*unknowns, x}
    abstracted = [leaves.abstract(e, everything) for e in built]
    definitions = Definitions(leaves)
    polynomials = eliminate(make_polynomials(abstracted, [*unknowns, x]), unknowns, [x], definitions)
    coefficients, value, removed = remove_spurious(polynomials, x, definitions, rng)
    positive = [leaves.abstract(e, {x}) for e in conditions]
    made = draft(
        leaves=leaves, definitions=definitions.entries, coefficients=coefficients, value=value, x=x, positive=positive
    )
    try:
        trial = store.compile_vetted(made.text(""), "derived")
    except (RootmatchError, SyntaxError) as error:
        raise RootmatchError(
            "derive: the code made from these equations cannot be used, which is a fault of rootmatch and not of the "
            "equations; please report it with them"
        ) from error
    evaluator = Evaluator(trial.plan, trial.functions, statement.source, statement.target)
    solver = Solver(statement)
    judge = Judge(evaluator, instances(statement, sample, limits, rng, CASES, solver=solver))
    shared = judge.shared_count()
    surplus, stated = _count_constraints(solver, judge.cases)
    judge.check_wrong_sets(rng, surplus)
    orders = judge.constraints(shared, constraints)
    relations: dict[Any, int] = {}
    arguments: dict[Any, Any] = {}
    if shared:
        texts, relations, arguments = relation_texts(statement, leaves, judge, orders)
        made.functions += texts
        # without a relation to the first root a constraint's own root cannot be told among several
        orders = tuple(o for o in orders if o == judge.swept or root_order(o) in relations)
    made.plan |= {
        "key": key,
        "shared": shared,
        "orders": orders,
        "surplus": surplus,
        "stated": stated,
        "interval": limits,
        "relations": relations,
        "relation_arguments": arguments,
    }
    return store.compile_vetted(made.text(_header(statement, built, removed, made.plan)), "derived")


def _count_constraints(solver: Any, cases: Sequence[Any]) -> tuple[int | None, int | None]:
    """Constraints that a minimal set's and a hyper-edge's equations put on the points, None where not known."""
    rng = np.random.default_rng(2)
    counts = [count for case in cases[:CASES_COUNTED] for count in solver.constraints(case, rng)]
    return min((one for one, _ in counts), default=None), min((other for _, other in counts), default=None)


def _header(statement: Any, built: Sequence[Any], removed: Sequence[str], plan: dict[str, Any]) -> str:
    lines = ["Generated by rootmatch; an edited file is generated anew or refused.", "", "Equations, each 0:"]
    lines += [f"    {str(e) if len(str(e)) < 400 else str(e)[:397] + '...'}" for e in built]
    lines.append(f"Shared: {statement.shared}. Eliminated: {', '.join(map(str, statement.unknowns)) or 'nothing'}.")
    lines.append(f"Factors taken off: {', '.join(removed) or 'none'}.")
    if plan["surplus"]:
        lines.append(f"A minimal set is over-determined; constraints that the polynomial lacks: {plan['surplus']}.")
    if plan["stated"] is not None:
        lines.append(f"Constraints of a hyper-edge: {plan['stated']}, used: {len(plan['orders'])}.")
    return "\n".join(lines).replace("\\", "/").replace('"', "'") + "\n"

"""The single-precision twins of kernels, compiled for the processor, against the kernels they are made from."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from numba import njit, typeof
from numpy.typing import NDArray

from cuda_cases import SINGLE, Case, case_scene
from rootmatch.algebra.vector import dot
from rootmatch.backends import cpu
from rootmatch.backends.strongest import Enumeration
from rootmatch.jit import float32
from rootmatch.jit.decorators import scalar
from rootmatch.problems.residual_dispatch import (
    PANEL_ROWS,
    SCRATCH_COLUMNS,
    SCRATCH_ROWS,
    edge_residual,
    fill_panel,
    gives_squares,
    has_single,
    slab_residual,
)
from rootmatch.problems.residual_kinds import QR, Joint

COMPUTES = r"\b(?:fadd|fsub|fmul|fdiv|fneg|fcmp|fpext|fptrunc|sqrt\S*)\b[^\n]*\bdouble\b"
"""LLVM's instructions on doubles, but for moves, loads and stores."""


@njit(error_model="numpy")
def rows(tables, kind, i, j, first, panel, scratch, out):  # type: ignore[no-untyped-def]
    """One slab."""
    fill_panel(tables, kind, i, j, panel)
    slab_residual(tables, kind, i, j, first, panel, scratch, out)


@njit(error_model="numpy")
def one(tables, kind, i, j, out):  # type: ignore[no-untyped-def]
    """One hyper-edge."""
    out[0] = edge_residual(tables, kind, i, j)


def slabs(case: Case, tables: Any, number: Any) -> NDArray[Any]:
    """Residuals (S, rows, n') of the case's slabs in the precision of ``number``; NaN where there is no hyper-edge."""
    n, n_target = case.shape
    kind = case.kind(case.pairs)
    work = Enumeration.of(tables, kind, case.shape, case.order, None)
    panel = np.zeros((PANEL_ROWS, n_target), number)
    scratch = np.zeros((SCRATCH_ROWS, max(n, SCRATCH_COLUMNS)), number)
    made = np.full((work.ranks, n - case.order + 1, n_target), np.nan, number)
    for rank, out in enumerate(made):
        base, order = divmod(rank, len(work.arrangements))
        i, j = np.append(work.bases[base], 0), np.append(work.arrangements[order], 0).astype(np.int64)
        first = int(i[-2]) + 1
        rows(tables, kind, i, j, first, panel, scratch, out[: n - first])
        out[:, work.arrangements[order]] = np.nan
    return np.sqrt(made) if gives_squares(tables, kind) else made


def in_double(case: Case, tables: Any) -> NDArray[Any]:
    """The same by the kernel of single hyper-edges, which other tests compile too."""
    n, n_target = case.shape
    work = Enumeration.of(tables, case.kind(case.pairs), case.shape, case.order, None)
    places, sources, targets = [], [], []
    for rank in range(work.ranks):
        base, order = divmod(rank, len(work.arrangements))
        i, j = work.bases[base].tolist(), work.arrangements[order].tolist()
        for last in range(i[-1] + 1, n):
            for image in sorted(set(range(n_target)) - set(j)):
                places.append((rank, last - i[-1] - 1, image))
                sources.append((*i, last))
                targets.append((*j, image))
    made = np.full((work.ranks, n - case.order + 1, n_target), np.nan)
    made[tuple(np.array(places).T)] = cpu.residuals(tables, case.kind(case.pairs), np.array(sources), np.array(targets))
    return made


@pytest.mark.parametrize("name", list(SINGLE))
class TestCompiledTwins:
    def test_near_the_kernels(self, name: str) -> None:
        case = SINGLE[name]
        tables, _ = case_scene(case)
        here, there = in_double(case, tables), slabs(case, float32.round_tables(tables), np.float32)
        assert there.dtype == np.float32
        near = here < 20.0
        assert near.sum() >= 20
        apart = np.abs(there[near] - here[near])
        assert np.median(apart) < 1e-3
        # near a double root of a false one it is anything
        assert np.mean(apart < 0.02) > 0.97
        # and not the same: it would be double precision in disguise
        assert np.median(np.abs(there[near] - here[near].astype(np.float32))) > 0.0

    def test_an_edge_is_as_in_its_slab(self, name: str) -> None:
        case = SINGLE[name]
        tables, truth = case_scene(case)
        blurred, kind = float32.round_tables(tables), case.kind(case.pairs)
        i = np.arange(case.order)
        out = np.zeros(1, np.float32)
        one(blurred, kind, i, truth[i], out)
        (exact,) = cpu.residuals(tables, kind, i[None], truth[i][None])
        assert float(out[0]) == pytest.approx(exact, abs=0.02)

    def test_no_double_is_computed(self, name: str) -> None:
        """In LLVM's code for the processor, where NVIDIA's compiler is not at hand."""
        case = SINGLE[name]
        tables, _ = case_scene(case)
        given = float32.round_tables(tables)
        slabs(case, given, np.float32)
        types = typeof(given), typeof(case.kind())
        (signature,) = (one for one in rows.signatures if one[:2] == types)
        assert re.findall(COMPUTES, rows.inspect_llvm(signature)) == []


def test_doubles_are_found_where_they_are_computed() -> None:
    @njit
    def add(x):  # type: ignore[no-untyped-def]
        x[0] += x[1]

    found = []
    for number in (np.float32, np.float64):
        add(np.ones(2, number))
        found.append(len(re.findall(COMPUTES, add.inspect_llvm(add.signatures[-1]))))
    assert found == [0, 1]


@pytest.mark.parametrize("value", [0.5, -3.0, 1e-12, 0.0, math.inf, -math.inf, 7, True, None, "text"])
def test_constants_that_single_precision_holds(value: Any) -> None:
    made = float32.round_constant(value)
    assert made == (np.float32(value) if isinstance(value, float) else value)
    assert isinstance(made, np.float32) == isinstance(value, float)


def test_constants_out_of_range_keep_their_meaning() -> None:
    """Next to nothing does not become 0, nor a bound infinite."""
    tiny, huge, less, wrong = float32.round_constant((1e-300, 1e300, -1e-60, math.nan))
    assert tiny > 0.0
    assert np.isfinite(np.float32(1.0) / tiny)
    assert np.isfinite(huge)
    assert less < 0.0
    assert np.isnan(wrong)


def test_no_constant_of_a_twin_vanishes_or_overflows() -> None:
    """In all that the twins of all cases are made of."""
    for case in SINGLE.values():
        slabs(case, float32.round_tables(case_scene(case)[0]), np.float32)
    seen = 0
    for kernel in tuple(float32._twins):
        function, twin = (getattr(one, "py_func", one) for one in (kernel, float32.single_precision_twin(kernel)))
        for before, after in zip(function.__code__.co_consts, twin.__code__.co_consts, strict=True):
            if isinstance(before, float) and math.isfinite(before):
                assert type(after) is np.float32
                assert np.isfinite(after)
                assert (after != 0.0) == (before != 0.0)
                seen += 1
        assert not [
            name for name, value in twin.__globals__.items() if isinstance(value, float) and type(value) is float
        ]
    assert seen > 50


def test_a_twin_is_the_same_code() -> None:
    assert float32.single_precision_twin(dot).py_func.__code__.co_code == dot.py_func.__code__.co_code
    assert float32.single_precision_twin(dot) is float32.single_precision_twin(dot)
    assert float32.single_precision_twin(dot).targetoptions == dot.targetoptions


def test_a_kernel_with_a_function_inside_is_refused() -> None:
    @scalar
    def nested(x):  # type: ignore[no-untyped-def]
        return (lambda y: y + 0.5)(x)

    with pytest.raises(TypeError, match=r"nested.*function inside"):
        float32.single_precision_twin(nested)


def test_doubles_get_the_kernel_itself() -> None:
    case = next(iter(SINGLE.values()))
    tables, _ = case_scene(case)
    assert float32.kernel_for_tables(tables, dot) is dot
    assert float32.kernel_for_tables(float32.round_tables(tables), dot) is float32.single_precision_twin(dot)


def test_rounding_adds_to_the_noise_of_a_bearing_alone() -> None:
    tables, _ = case_scene(Case("p3p", Joint))
    blurred = float32.round_tables(tables)
    for field in tables._fields:
        if field in ("rays", "versine", "normals"):
            np.testing.assert_array_equal(getattr(blurred, field), getattr(tables, field).astype(np.float32))
    grown = blurred.variance.astype(float) - tables.variance
    assert np.all(grown > 0.0)
    assert np.all(grown < 1e-3 * tables.variance)


@pytest.mark.parametrize("problem", ["p3p", "up2p"])
def test_the_unit_of_length_is_that_of_the_errors(problem: str) -> None:
    """By a power of two, for all lengths alike, so that no digit changes."""
    tables, _ = case_scene(Case(problem, Joint))
    blurred = float32.round_tables(tables)
    unit = float(blurred.points[0, 0]) / float(np.float32(tables.points[0, 0]))
    assert math.frexp(unit)[0] == 0.5
    assert 0.5 < unit * math.sqrt(np.median(tables.variance)) < 2.0
    np.testing.assert_array_equal(blurred.points, (tables.points * unit).astype(np.float32))
    if problem == "p3p":
        np.testing.assert_array_equal(blurred.distance2, (tables.distance2 * unit**2).astype(np.float32))


def test_where_the_ranking_survives() -> None:
    assert has_single(case_scene(Case("p3p", Joint))[0], Joint())
    assert not has_single(case_scene(Case("p3p", QR))[0], QR())
    assert not has_single(case_scene(Case("3p1", Joint))[0], Joint())

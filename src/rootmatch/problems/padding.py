"""Padding behind the target points, so that loops over them fill whole vectors.

A loop over 20 targets is two vectors of eight and four scalars, and the four cost more than the two. Tables whose
target axis is a multiple of eight have no such rest. The padding repeats the last target and is never used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba.extending import overload

from rootmatch.arrays import Floats, Integers
from rootmatch.jit.dispatch import tuple_class
from rootmatch.problems.kernels import kernel_record

LANES = 8
"""Targets that are evaluated together: the doubles of the widest vector (AVX-512)."""


def pad_tables(tables: Any, targets: int) -> Any:
    """Tables of n' = ``targets`` points with padding behind them; as they are where their record names no fields."""
    if targets % LANES == 0 or not kernel_record(tables).target_fields:
        return tables
    return select_targets(tables, padded_places(targets), targets)


def padded_places(targets: int) -> Integers:
    """Target indices with padding behind them: the last index repeated."""
    return np.minimum(np.arange(targets + -targets % LANES), targets - 1)


def select_targets(tables: Any, chosen: Integers, targets: int) -> Any:
    """Tables of some of the n' = ``targets`` target points, one of them more than once if need be."""
    return _select_points(tables, kernel_record(tables).target_fields, chosen, targets)


def select_sources(tables: Any, chosen: Integers, sources: int) -> Any:
    """Tables of some of the n = ``sources`` source points, whose record names the fields that have such an axis."""
    return _select_points(tables, kernel_record(tables).source_fields, chosen, sources)


def _select_points(tables: Any, names: Sequence[str], chosen: Integers, points: int) -> Any:
    """Tables with some of so many points on each axis of these fields that has as many."""
    fewer = {}
    for name in names:
        field = getattr(tables, name)
        for axis, size in enumerate(field.shape):
            if size == points:
                field = np.take(field, chosen, axis=axis)
        fewer[name] = np.ascontiguousarray(field)
    return tables._replace(**fewer)


def pad_rows(rows: Floats, columns: int) -> Floats:
    """An array (k, n') that repeats its last column up to ``columns``; itself where it has as many."""
    if rows.shape[1] == columns:
        return rows
    wider = np.empty((len(rows), columns))
    wider[:, : rows.shape[1]] = rows
    wider[:, rows.shape[1] :] = rows[:, -1:]
    return wider


def target_columns(tables: Any, targets: int) -> int:
    """Targets of the tables, the padding behind them included."""
    names = kernel_record(tables).target_fields
    return int(getattr(tables, names[0]).shape[1]) if names else targets


@overload(target_columns)
def _columns_overload(tables: Any, targets: Any) -> Callable[..., Any]:
    names = kernel_record(tables).target_fields
    if not names:

        def as_given(tables: Any, targets: Any) -> Any:  # with the annotations of the overload, which Numba compares
            return targets

        return as_given
    position = tuple_class(tables)._fields.index(names[0])

    def implementation(tables: Any, targets: Any) -> Any:
        return tables[position].shape[1]

    return implementation

"""Hyper-edges as rows of flat indices (E, d): one order for each, and which are the same."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def unique_rows(rows: NDArray[Any], base: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row number of the first of each distinct row, in ascending order of rows, and the group (E,) of each row.

    Entries lie in 0 … base − 1.
    """
    _, first, group = np.unique(**_unique_arguments(rows, base), return_index=True, return_inverse=True)
    return first, group.reshape(-1)


def first_rows(rows: NDArray[Any], base: int) -> NDArray[np.intp]:
    """Row number of the first of each distinct row, as `unique_rows` gives it, for callers that need no groups."""
    first: NDArray[np.intp] = np.unique(**_unique_arguments(rows, base), return_index=True)[1]
    return first


def row_keys(rows: NDArray[Any], base: int) -> NDArray[np.int64]:
    """One number for each row, ascending as the rows do. Entries lie in 0 … base − 1, and base^d below 2⁶³."""
    keys = np.zeros(len(rows), np.int64)
    for column in rows.T:
        keys = keys * base + column
    return keys


def _unique_arguments(rows: NDArray[Any], base: int) -> dict[str, Any]:
    """Arguments of `numpy.unique`: rows as one integer each where they fit, which compares ten times as fast."""
    if float(base) ** rows.shape[1] >= 2.0**63:
        return {"ar": rows, "axis": 0}
    return {"ar": row_keys(rows, base)}


def are_one_to_one(rows: NDArray[Any], n_target: int) -> NDArray[np.bool_]:
    """Whether the correspondences of each row have distinct source points and distinct target points, (E,)."""
    source, target = np.sort(rows // n_target, axis=1), np.sort(rows % n_target, axis=1)
    distinct = (np.diff(source, axis=1) > 0) & (np.diff(target, axis=1) > 0)
    return np.asarray(distinct.all(axis=1))

"""The one-change neighbourhood of an assignment against all assignments there are."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from rootmatch.model.weighed_labellings import Changes, likely_changes


def one_change_neighbours(assignment: NDArray[np.int64], n_target: int, *, resize: bool = False) -> Changes:
    """The assignments that differ by one change: a moved point, or two points with exchanged targets.

    Listed in this order: a matched point moved to a free target; a matched point exchanged with another one, or its
    target handed to an unmatched point.

    Parameters
    ----------
    assignment : (n,) int64 array
        −1 where unmatched.
    n_target : int
    resize : bool
        Also changes of how many points are matched: an unmatched point to a free target, and, after all moves, a
        matched point that becomes unmatched.
    """
    matched = assignment >= 0
    free = np.ones(n_target, np.bool_)
    free[assignment[matched]] = False
    source, target = np.nonzero((matched | resize)[:, None] & free)
    dropped = np.flatnonzero(matched & resize)
    every = np.arange(len(assignment))
    first, second = np.nonzero(matched[:, None] & (~matched | (every[:, None] < every)))
    none = np.full(len(source) + len(dropped), -1)
    return Changes(
        np.concatenate([source, dropped, first]),
        np.concatenate([target, none[: len(dropped)], assignment[second]]),
        np.concatenate([none, second]),
        np.concatenate([none, assignment[first]]),
    )


def one_to_one(n: int, n_target: int) -> list[tuple[int, ...]]:
    """All assignments, partial ones too."""
    every = product(range(-1, n_target), repeat=n)
    return [row for row in every if len({k for k in row if k >= 0}) == sum(k >= 0 for k in row)]


def is_one_change(before: tuple[int, ...], after: tuple[int, ...], resize: bool) -> bool:
    """By definition: a point moved to a free target, two points with exchanged targets, or one matched or unmatched."""
    differ = [i for i in range(len(before)) if before[i] != after[i]]
    if len(differ) == 2:
        i, j = differ
        return (after[i], after[j]) == (before[j], before[i])
    moved = len(differ) == 1 and before[differ[0]] >= 0 and after[differ[0]] >= 0
    return moved or (resize and len(differ) == 1)


@pytest.mark.parametrize("resize", [False, True])
@pytest.mark.parametrize(("n", "n_target"), [(3, 4), (4, 3), (1, 2), (2, 1)])
def test_neighbours_are_all_assignments_at_one_change(n: int, n_target: int, resize: bool) -> None:
    every = one_to_one(n, n_target)
    for before in every:
        changes = one_change_neighbours(np.array(before), n_target, resize=resize)
        found: NDArray[np.int64] = changes.apply_to(np.array(before))
        rows = [tuple(row) for row in found.tolist()]
        assert len(rows) == len(set(rows))
        assert set(rows) == {after for after in every if is_one_change(before, after, resize)}
        some = changes.take(np.arange(len(rows))[::2])
        assert [tuple(row) for row in some.apply_to(np.array(before)).tolist()] == rows[::2]


@pytest.mark.parametrize("minimum", [-np.inf, -1.0, 0.5])
def test_likely_changes_are_the_neighbours_that_gain_enough(minimum: float) -> None:
    rng = np.random.default_rng(3)
    for before in one_to_one(4, 3):
        assignment, gains = np.array(before), rng.normal(size=(4, 3))
        every = one_change_neighbours(assignment, 3, resize=True)
        after = every.apply_to(assignment)
        added = np.where(after >= 0, gains[np.arange(4), after], 0.0).sum(axis=1)
        added -= sum(gains[i, k] for i, k in enumerate(before) if k >= 0)
        expected = {tuple(row): gain for row, gain in zip(after.tolist(), added, strict=True) if gain > minimum}
        changes, found = likely_changes(assignment, gains, minimum)
        rows = [tuple(row) for row in changes.apply_to(assignment).tolist()]
        assert dict(zip(rows, found, strict=True)) == pytest.approx(expected)
        assert len(rows) == len(expected)

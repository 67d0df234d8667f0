"""Results that are kept by the values of arrays."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rootmatch.arrays import cache_by_identity, cache_by_values


def test_a_function_is_called_once_for_the_same_values() -> None:
    calls: list[tuple[int, ...]] = []

    @cache_by_values(4)
    def doubled(some: NDArray[np.float64], more: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        calls.append(some.shape)
        return 2.0 * some if more is None else some + more

    square = np.arange(4.0).reshape(2, 2)
    assert doubled(square) is doubled(square.T.copy().T)
    np.testing.assert_array_equal(doubled(square[:, ::-1]), 2.0 * square[:, ::-1])
    np.testing.assert_array_equal(doubled(square, more=square), 2.0 * square)
    assert calls == [(2, 2)] * 3
    assert doubled(square.ravel()).shape == (4,)  # the same bytes
    assert doubled(square.astype(np.int64)).dtype == np.float64
    assert calls[3:] == [(4,), (2, 2)]
    doubled(square)
    assert len(calls) == 6, "the last four are kept"


def test_arrays_are_not_written_into() -> None:
    @cache_by_values(1)
    def cleared(some: NDArray[np.float64]) -> None:
        some[:] = 0.0

    with pytest.raises(ValueError, match="read-only"):
        cleared(np.ones(3))


def test_a_function_is_called_once_for_the_same_object() -> None:
    """Not for an equal one: that would have to be compared; and not longer than the last of them."""
    calls = []

    @cache_by_identity(2)
    def first(values: list[int]) -> int:
        calls.append(values)
        return values[0]

    one, equal, other = [1], [1], [2]
    assert [first(one), first(one), first(equal), first(one)] == [1, 1, 1, 1]
    assert len(calls) == 2
    assert first(other) == 2
    assert first(one) == 1
    assert len(calls) == 4


def test_a_function_is_called_once_for_the_same_objects() -> None:
    calls = []

    @cache_by_identity(4)
    def joined(first: list[int], second: list[int] | None) -> list[int]:
        calls.append((first, second))
        return first + (second or [])

    one, other = [1], [2]
    assert joined(one, other) is joined(one, other)
    assert joined(other, one) == [2, 1]
    assert joined(one, None) == [1]
    assert len(calls) == 3

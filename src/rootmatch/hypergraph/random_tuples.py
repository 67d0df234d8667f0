"""Random tuples and sets of distinct points: the only place where they are drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


def distinct_tuples(
    rng: np.random.Generator,
    count: int | tuple[int, ...],
    points: int | NDArray[np.int64],
    size: int,
    dtype: DTypeLike = np.int64,
) -> NDArray[Any]:
    """Uniform ordered tuples (count, size) of distinct indices below ``points``, without rejection.

    ``points`` may be of each tuple its own, of a shape that broadcasts to ``count``.

    Entry p is drawn among the ``points`` − p indices that are left and lifted over the earlier entries in increasing
    order. The stream of the generator depends on ``dtype``.
    """
    entries: list[NDArray[Any]] = []
    ascending: list[NDArray[Any]] = []
    for p in range(size):
        drawn = rng.integers(0, points - p, count, dtype)
        for earlier in ascending:
            drawn += drawn >= earlier
        entries.append(drawn)
        # insert the new entry: it moves down past the greater ones
        moving = drawn
        for q, earlier in enumerate(ascending):
            ascending[q], moving = np.minimum(earlier, moving), np.maximum(earlier, moving)
        ascending.append(moving)
    return np.stack(entries, axis=-1)


def permuted_tuples(rng: np.random.Generator, count: int, points: int, size: int) -> NDArray[np.int64]:
    """Uniform ordered tuples (count, size) of distinct indices below ``points``: the first ones of random permutations.

    `distinct_tuples` is quicker; this is for callers whose results are compared with those of this stream.
    """
    return np.asarray(np.argsort(rng.random((count, points)), axis=1)[:, :size])


def distinct_sets(rng: np.random.Generator, count: int, points: int, size: int) -> NDArray[np.int64]:
    """At most ``count`` uniform sets (…, size) of distinct indices below ``points``, ascending; one may come twice.

    Draws with repeated indices are rejected: cheaper than `distinct_tuples` where no exact number is needed.
    """
    drawn = np.sort(rng.integers(0, points, (count, size)), axis=1)
    return np.asarray(drawn[(drawn[:, 1:] != drawn[:, :-1]).all(axis=1)])

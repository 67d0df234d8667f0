"""Types of arrays, for annotations, and results that are kept by the values of arrays."""

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

P = ParamSpec("P")
R = TypeVar("R")


class _Values(NamedTuple):
    """An array as a key."""

    content: bytes
    kind: str
    shape: tuple[int, ...]


def kept_by_values(most: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator that keeps the last results of a function by the values of its arguments, arrays among them.

    For what frame after frame, or every search, asks again of the same body. The function gets read-only arrays; who
    gets its result shares it with all others, and does not write into it.
    """

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        @lru_cache(maxsize=most)
        def known(*arguments: Any, **named: Any) -> R:
            return function(*map(_array, arguments), **{name: _array(one) for name, one in named.items()})

        @wraps(function)
        def by_values(*arguments: P.args, **named: P.kwargs) -> R:
            return known(*map(_key, arguments), **{name: _key(one) for name, one in named.items()})

        by_values.cache_clear = known.cache_clear  # type: ignore[attr-defined]
        return by_values

    return decorated


def _key(value: Any) -> Any:
    return _Values(value.tobytes(), value.dtype.str, value.shape) if isinstance(value, np.ndarray) else value


def _array(key: Any) -> Any:
    return np.frombuffer(key.content, key.kind).reshape(key.shape) if isinstance(key, _Values) else key

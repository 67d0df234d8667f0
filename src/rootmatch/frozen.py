"""Frozen values: copies with some fields changed, and what is worked out of one once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, Self, TypeVar, overload

Value = TypeVar("Value")


def copy_with(value: Value, **fields: Any) -> Value:
    """As `dataclasses.replace`, in a fifth of its time, for a class that checks nothing when a value is made.

    Stages hand on findings with dozens of fields, several times in each frame of a tracker. What was worked out once is
    left behind, as by `dataclasses.replace`.
    """
    known = type(value).__dataclass_fields__  # type: ignore[attr-defined]
    out, count = object.__new__(type(value)), len(known)
    after = out.__dict__
    after |= value.__dict__
    while len(after) > count:  # what was worked out once comes after the fields
        after.popitem()
    after |= fields
    if len(after) > count:
        raise TypeError(f"{type(value).__name__} has no field {', '.join(fields.keys() - known.keys())}")
    return out


def amend(value: Value, *lost: str, **fields: Any) -> Value:
    """As `copy_with`, with what was worked out once but for what is ``lost``: all that depends on changed fields."""
    out = object.__new__(type(value))
    after = out.__dict__
    after |= value.__dict__
    after |= fields
    for name in lost:
        after.pop(name, None)
    return out


class once(Generic[Value]):  # noqa: N801
    """As `functools.cached_property`, without the lock of Python 3.11: a tracker's frame asks for thirty of these."""

    def __init__(self, function: Callable[[Any], Value]) -> None:
        self.function, self.name, self.__doc__ = function, function.__name__, function.__doc__

    @overload
    def __get__(self, one: None, kind: type) -> Self: ...
    @overload
    def __get__(self, one: object, kind: type) -> Value: ...
    def __get__(self, one: object, kind: type) -> Self | Value:
        if one is None:
            return self
        value = one.__dict__[self.name] = self.function(one)
        return value

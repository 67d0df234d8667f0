"""Copies of frozen values with some fields changed."""

from __future__ import annotations

from typing import Any, TypeVar

Value = TypeVar("Value")


def copied(value: Value, **fields: Any) -> Value:
    """As `dataclasses.replace`, in a fifth of its time, for a class that checks nothing when a value is made.

    Stages hand on findings with dozens of fields, several times in each frame of a tracker. Cached properties are left
    behind, as by `dataclasses.replace`.
    """
    known = type(value).__dataclass_fields__  # type: ignore[attr-defined]
    if not fields.keys() <= known.keys():
        raise TypeError(f"{type(value).__name__} has no field {', '.join(fields.keys() - known.keys())}")
    out = object.__new__(type(value))
    state = {name: one for name, one in vars(value).items() if name in known}
    vars(out).update(state | fields)
    return out

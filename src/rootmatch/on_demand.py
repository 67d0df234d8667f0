"""Values of a dataclass that are computed when they are first read, such as the score of a match that poses decide."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import Field, fields
from typing import Any, Generic, TypeVar, cast, overload

T = TypeVar("T")


class OnDemand(Generic[T]):
    """A field that is given a value, or a function without arguments that makes it on first access."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> OnDemand[T]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> T: ...
    def __get__(self, instance: object | None, owner: type) -> OnDemand[T] | T:
        if instance is None:
            raise AttributeError(self.name)  # a field without a default
        value = vars(instance)[self.name]
        if callable(value):
            value = vars(instance)[self.name] = value()
        return cast("T", value)

    def __set__(self, instance: object, value: T | Callable[[], T]) -> None:
        vars(instance)[self.name] = value


class Once(Generic[T]):
    """A function without arguments that is called once: a fifth of what `functools.cache` takes to make."""

    __slots__ = ("make", "values")

    def __init__(self, make: Callable[[], T]) -> None:
        self.make = make
        self.values: list[T] = []

    def __call__(self) -> T:
        """What it returned the first time."""
        if not self.values:
            self.values.append(self.make())
        return self.values[0]


def unread(instance: object, name: str) -> Any:
    """The value of a field, or, where it was not read yet, a function that reads it."""
    return (lambda: getattr(instance, name)) if callable(vars(instance)[name]) else vars(instance)[name]


def changed(instance: T, **changes: Any) -> T:
    """As `dataclasses.replace`, without reading what was not read yet."""
    values = {field.name: unread(instance, field.name) for field in _fields(instance) if field.name not in changes}
    return type(instance)(**values, **changes)


def all_read(instance: Any) -> dict[str, Any]:
    """The attributes of a dataclass after every field was read, say to be pickled."""
    return {**vars(instance), **{field.name: getattr(instance, field.name) for field in _fields(instance)}}


def _fields(instance: Any) -> tuple[Field[Any], ...]:
    return fields(instance)

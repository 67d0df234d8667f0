"""Options of an algorithm: a frozen dataclass whose fields say within which range they lie, checked in one place."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from typing import Any

from rootmatch.errors import InputError


def option(
    default: Any, *, above: float | None = None, minimum: float | None = None, maximum: float | None = None
) -> Any:
    """A field of `Options` with its default and range: above a bound, at least and at most another."""
    return field(default=default, metadata={"above": above, "minimum": minimum, "maximum": maximum})


@dataclass(frozen=True)
class Options:
    """Base of every options class; making one checks its fields.

    The kind of a field is that of its annotation (``int``, ``float``, ``bool``, or other `Options`); the range
    is that of `option`. What is annotated ``… | None`` may be None.

    Raises
    ------
    InputError
        If a field has the wrong kind or lies outside its range.
    """

    def __post_init__(self) -> None:
        for entry in fields(self):
            value, kind = getattr(self, entry.name), str(entry.type)
            if value is None and kind.endswith("| None"):
                continue
            if isinstance(entry.default, Options):
                usable, expected = isinstance(value, type(entry.default)), type(entry.default).__name__
            elif kind.startswith(("int", "float")):
                number = kind.split(" ")[0]
                usable, expected = _is_within_range(value, number, entry), f"{_NUMBERS[number]}{_range(entry)}"
            elif kind == "bool":
                usable, expected = isinstance(value, bool), "True or False"
            else:
                continue
            if not usable:
                raise InputError(f"{type(self).__name__}: {entry.name} is {value!r}; give {expected}")


_NUMBERS = {"int": "a whole number", "float": "a number"}


def _is_within_range(value: Any, number: str, entry: Any) -> bool:
    """Whether a value is such a number and lies within the range of its field."""
    if isinstance(value, bool) or not isinstance(value, Integral if number == "int" else Real):
        return False
    above, minimum, maximum = (entry.metadata.get(name) for name in ("above", "minimum", "maximum"))
    inside = (above is None or value > above) and (minimum is None or value >= minimum)
    return bool(inside and (maximum is None or value <= maximum) and abs(float(value)) < float("inf"))


def _range(entry: Any) -> str:
    """The range of a field in words."""
    above, minimum, maximum = (entry.metadata.get(name) for name in ("above", "minimum", "maximum"))
    words = [
        "" if above is None else f"above {above:g}",
        "" if minimum is None else f"of at least {minimum:g}",
        "" if maximum is None else f"of at most {maximum:g}",
    ]
    told = " and ".join(word for word in words if word)
    return f" {told}" if told else ""

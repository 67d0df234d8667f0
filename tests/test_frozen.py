"""Copies of frozen values and what is worked out of one once: as `dataclasses` and `functools` have them."""

from dataclasses import dataclass, replace

import pytest

from rootmatch.frozen import amend, copy_with, once


@dataclass(frozen=True, eq=False)
class Value:
    first: int
    second: str = "as usual"

    @once
    def twice(self) -> int:
        return 2 * self.first


def test_a_copy_has_the_other_fields_and_none_of_what_was_worked_out() -> None:
    value = Value(3, "other")
    assert value.twice == 6
    copy, expected = copy_with(value, first=4), replace(value, first=4)
    assert vars(copy) == vars(expected)
    assert copy.twice == 8
    assert value.twice == 6


def test_an_amended_copy_keeps_what_was_worked_out_but_for_what_is_lost() -> None:
    value = Value(3)
    assert value.twice == 6
    assert vars(amend(value, second="other")) == {"first": 3, "second": "other", "twice": 6}
    assert amend(value, "twice", first=4).twice == 8
    assert vars(value) == {"first": 3, "second": "as usual", "twice": 6}


def test_an_unknown_field_is_an_error() -> None:
    with pytest.raises(TypeError, match="third"):
        copy_with(Value(3), third=4)


def test_what_is_asked_for_twice_is_worked_out_once() -> None:
    calls = []

    class Asked:
        @once
        def answer(self) -> int:
            """What is asked for."""
            calls.append(self)
            return 42

    asked = Asked()
    assert (asked.answer, asked.answer) == (42, 42)
    assert calls == [asked]
    assert Asked.answer.__doc__ == "What is asked for."

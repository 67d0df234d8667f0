"""Copies of frozen values and what is worked out of one once: as `dataclasses` and `functools` have them."""

from dataclasses import dataclass, replace

import pytest

from rootmatch.frozen import copied, once


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
    copy, expected = copied(value, first=4), replace(value, first=4)
    assert vars(copy) == vars(expected)
    assert copy.twice == 8
    assert value.twice == 6


def test_an_unknown_field_is_an_error() -> None:
    with pytest.raises(TypeError, match="third"):
        copied(Value(3), third=4)

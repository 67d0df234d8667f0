"""Options: kinds and ranges of their fields are checked, and every field says what it is."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import pytest

import rootmatch
from rootmatch.errors import InputError
from rootmatch.explain.match_options import MatchOptions
from rootmatch.options import Options, option
from rootmatch.samplers.guided.sampler import Guided
from rootmatch.solvers import MultiStartAscent


@dataclass(frozen=True)
class Inner(Options):
    part: float = option(0.5, above=0.0, maximum=1.0)


@dataclass(frozen=True)
class Outer(Options):
    count: int = option(3, minimum=1)
    rate: float = option(0.1, minimum=0.0)
    seconds: float | None = option(None, above=0.0)
    quick: bool = option(False)
    name: str = option("a")
    inner: Inner = option(Inner())


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"count": 0}, "Outer: count is 0; give a whole number of at least 1"),
        ({"count": 2.0}, "count is 2.0; give a whole number"),
        ({"count": True}, "count is True"),
        ({"rate": -1}, "rate is -1; give a number of at least 0"),
        ({"rate": float("nan")}, "rate is nan"),
        ({"rate": float("inf")}, "rate is inf"),
        ({"rate": "fast"}, "rate is 'fast'"),
        ({"seconds": 0.0}, "seconds is 0.0; give a number above 0"),
        ({"quick": 1}, "quick is 1; give True or False"),
        ({"inner": 0.5}, "inner is 0.5; give Inner"),
    ],
)
def test_values_outside_of_their_range_are_refused(given: dict[str, object], told: str) -> None:
    with pytest.raises(InputError) as caught:
        Outer(**given)  # type: ignore[arg-type]
    assert told in str(caught.value)


def test_values_within_their_range_are_kept() -> None:
    made = Outer(count=1, rate=0, seconds=0.5, quick=True, inner=Inner(1.0))
    assert (made.count, made.rate, made.seconds, made.inner.part) == (1, 0, 0.5, 1.0)
    assert Outer(seconds=None) == Outer()
    with pytest.raises(InputError, match="Inner: part is 0"):
        replace(made, inner=Inner(0))


def every_options_class() -> list[type[Options]]:
    """All options classes of the package."""
    for module in pkgutil.walk_packages(rootmatch.__path__, "rootmatch."):
        if module.name.startswith(("rootmatch.samplers", "rootmatch.solvers", "rootmatch.explain")):
            importlib.import_module(module.name)
    found: list[type[Options]] = []
    waiting = [Options]
    while waiting:
        below = [one for one in waiting.pop().__subclasses__() if one.__module__.startswith("rootmatch.")]
        found, waiting = found + below, waiting + below
    return found


def test_every_field_is_documented_and_every_default_within_its_range() -> None:
    classes = every_options_class()
    assert {Guided, MultiStartAscent} <= set(classes)
    for one in classes:
        one()
        documented: set[str] = set()
        for parent in inspect.getmro(one):
            if not issubclass(parent, Options) or parent is Options:
                continue
            body = ast.parse(textwrap.dedent(inspect.getsource(parent))).body[0].body  # type: ignore[attr-defined]
            for field, text in pairwise(body):
                if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                    documented.add(field.target.id)  # type: ignore[union-attr]
            for line in inspect.getdoc(parent).splitlines():  # type: ignore[union-attr]
                if not line.startswith(" ") and " : " in f"{line} : ":
                    documented.update(line.split(" : ")[0].split(", "))
        assert {field.name for field in fields(one)} <= documented, one


@pytest.mark.parametrize("call", [rootmatch.match, rootmatch.Matcher, rootmatch.Tracker])
def test_a_call_hands_on_all_of_its_options(call: Callable[..., Any]) -> None:
    """They are taken by their names, so one of another name would be lost."""
    given, own = inspect.signature(call).parameters, {one.name: one.default for one in fields(MatchOptions)}
    of_points = {"source", "target", "problem", "noise", "normals", "view_angle", "candidates", "bodies", "prior"}
    assert given.keys() <= own.keys() | of_points | {"source_noise", "tracking"}
    assert all(given[name].default == own[name] for name in given.keys() & own.keys())

"""A few of the calls and files that `make fuzz` tries by the ten thousand, and every one that ever failed."""

from __future__ import annotations

import json
import random
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import call_cases
import command_cases
import file_cases
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

KEPT = sorted(Path(__file__).with_name("kept").glob("*.json"))
USUAL: dict[str, tuple[Any, ...]] = {
    "residual": ("joint", "qr"),
    "solver": ("ascent", "power-l1", "magic"),
    "sampler": ("auto", "exhaustive", "random", "some"),
    "motions": (1, "auto", 0),
}
"""Options that other tests compile too."""

short = settings(
    max_examples=60, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


@pytest.fixture(autouse=True)
def _quiet() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@short
@given(st.randoms(use_true_random=False))
def test_calls(rng: random.Random) -> None:
    call_cases.attempt(call_cases.recipe(rng, ("p3p", "up2p"), **USUAL))


@settings(short, max_examples=400)
@given(st.randoms(use_true_random=False))
def test_files(rng: random.Random) -> None:
    file_cases.attempt(file_cases.recipe(rng))


@pytest.mark.parametrize("number", range(12))
def test_commands(number: int) -> None:
    command_cases.attempt(command_cases.recipe(random.Random(number)))


@pytest.mark.parametrize("base", command_cases.BASES[:10], ids=" ".join)
def test_the_command_lines_that_are_spoilt_are_good_ones(
    base: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # kernels may have to be compiled first
    monkeypatch.setattr(command_cases, "SECONDS", 120.0)
    monkeypatch.setattr(command_cases, "WAITING", 240.0)
    assert command_cases.attempt({"words": list(base), "closed": [], "stdin": "frames.csv"}) in (0, 1)


@pytest.mark.parametrize("kind", file_cases.KINDS)
def test_the_files_that_are_spoilt_are_good_ones(kind: str) -> None:
    assert file_cases.attempt({"kind": kind, "deeds": []}) is not None


def test_half_of_the_calls_are_answered() -> None:
    found = [call_cases.attempt(call_cases.recipe(random.Random(k), ("p3p",), **USUAL)) for k in range(20)]
    assert 5 <= sum(match is not None for match in found) <= 18


@pytest.mark.parametrize("path", KEPT, ids=[path.stem for path in KEPT])
def test_what_failed_once_holds(path: Path) -> None:
    kept = json.loads(path.read_text(encoding="utf-8"))
    import_module(f"{kept['what']}_cases").attempt(kept["recipe"])

"""Rows of the benchmark of all kinds of scenes: its intervals count scenes, so these have to be independent."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import together


@pytest.mark.parametrize(("of", "kind"), [("of_constellation", "constellations"), ("of_few", "few LEDs")])
def test_no_two_rows_show_the_same_scene(monkeypatch: pytest.MonkeyPatch, of: str, kind: str) -> None:
    """Families of constellations differ in their clutter alone if their seed is the same."""
    seeds: list[int] = []
    monkeypatch.setattr(together, "scenes_of", lambda name, folder: object())
    monkeypatch.setattr(together, of, lambda scenes, family, seed: seeds.append(seed))
    rows = [make for name, _, make in together.kinds_of(None) if name.startswith(kind)]
    for seed in (1000, 1001):
        for make in rows:
            make(seed)
    assert len(rows) > 1
    assert len(set(seeds)) == len(seeds) == 2 * len(rows)

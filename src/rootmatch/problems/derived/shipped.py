"""Formulas that come with the package: generated once from equations, so that they need no SymPy."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from rootmatch.problems.derived.store import Generated, vetted


@cache
def shipped(name: str, path: Path) -> Generated:
    """The formulas of a problem of that name in a file, vetted like any generated text."""
    return vetted(path.read_text(encoding="utf-8"), name)

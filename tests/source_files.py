"""The package's own files, each parsed once in a process: several tests look through all of them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[1] / "src" / "rootmatch"


@cache
def every_file() -> list[Path]:
    """All source files, sorted."""
    return sorted(SOURCES.rglob("*.py"))


@cache
def tree_of(path: Path) -> ast.Module:
    """The syntax of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes_of(path: Path) -> list[ast.AST]:
    """All nodes of a file, as of `ast.walk`."""
    return list(ast.walk(tree_of(path)))

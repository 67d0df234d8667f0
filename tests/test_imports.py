"""What the source files import: no module needs itself, and none is imported for what its import does."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

from source_files import SOURCES, every_file, tree_of


def modules() -> dict[str, Path]:
    """Every source file by the name of its module."""
    found = {}
    for path in every_file():
        parts = path.relative_to(SOURCES.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """The modules of the package that a file names in imports, on top and inside functions.

    Not those for type checkers only: a report names the type of what it reports, and a match writes its report.
    """
    found = set()
    waiting: list[ast.AST] = [tree_of(path)]
    while waiting:
        node = waiting.pop()
        skipped = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        waiting += node.orelse if skipped else ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & known.keys()
            found |= submodules
            if len(submodules) < len(node.names):
                found.add(str(node.module))
    return found & known.keys()


def test_no_modules_import_each_other() -> None:
    known = modules()
    assert len(known) > 100
    TopologicalSorter({name: imported(path, known) for name, path in known.items()}).prepare()  # raises `CycleError`


def test_nothing_is_imported_for_its_side_effects() -> None:
    silenced = re.compile(r"#\s*noqa:[^#]*\bF401\b")
    assert [str(path) for path in every_file() if silenced.search(path.read_text(encoding="utf-8"))] == []

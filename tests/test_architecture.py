"""docs/architecture.svg shows the imports of today."""

from __future__ import annotations

import ast
import importlib.util
import itertools
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[1] / "docs" / "make_architecture.py"


@pytest.fixture
def drawing(monkeypatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_architecture", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


def test_the_committed_picture_is_what_the_script_draws(drawing):
    assert drawing.PICTURE.read_text(encoding="utf-8") == drawing.svg(), "run python docs/make_architecture.py"


def test_implied_imports_are_left_out(drawing):
    graph = {"a": {"b", "c", "d"}, "b": {"c"}, "c": {"d"}, "d": set()}
    assert drawing.thinned(graph) == [("a", "b"), ("b", "c"), ("c", "d")]


def test_imports_inside_functions_count(drawing):
    tree = ast.parse("import numpy\ndef f():\n    from rootmatch.io import points\nfrom rootmatch import match\n")
    assert set(drawing.imported(tree)) == {"io", "match"}


def test_boxes_of_a_row_do_not_overlap(drawing):
    rows = drawing.layers()
    packages = {name for row in rows for name in row}
    grid, _ = drawing.placed(rows, drawing.thinned(drawing.imports(packages)))
    for row in grid:
        for left, right in itertools.pairwise(row):
            assert right.x - left.x >= (left.width + right.width) / 2

"""docs/architecture.svg shows the imports of today, and the pages name files that exist."""

from __future__ import annotations

import ast
import importlib.util
import itertools
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / "docs" / "make_architecture.py"
FOLDERS = ("src", "tests", "benchmarks", "examples", "docs", "build_backend")
WRITTEN = {"ransac.py"}
"""Files that are not of this repository."""


@pytest.fixture(scope="module")
def drawing() -> Iterator[ModuleType]:
    """The script, which reads the imports of all files once."""
    spec = importlib.util.spec_from_file_location("make_architecture", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, spec.name, module)
        spec.loader.exec_module(module)
        imports = cache(module.imports)
        patch.setattr(module, "imports", lambda packages: imports(frozenset(packages)))
        yield module


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


PAGES = sorted(
    page for page in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*/README.md")]
    if not {"_build", "gallery", "concepts"} & set(page.relative_to(ROOT).parts)
)  # fmt: skip


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_that_a_page_names_exist(page):
    files = {f"/{path.relative_to(ROOT).as_posix()}" for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
    named = {name.lstrip("./") for name in re.findall(r"[\w./-]*\w\.py\b", page.read_text(encoding="utf-8"))}
    if page.parent.name == "notebook":  # it names modules as they were on the day; what it says to run is there
        named = {name for name in named if name.startswith(("benchmarks/", "tests/", "docs/", "examples/"))}
    missing = {name for name in named - WRITTEN if not any(file.endswith(f"/{name}") for file in files)}
    assert missing == set()

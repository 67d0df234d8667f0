"""The trust boundary of SECURITY.md: what may execute text or unpickle, and that files cannot."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import rootmatch as rm
from rootmatch.errors import InputError, RootmatchError
from rootmatch.problems.derived.store import compile_vetted
from source_files import SOURCES, every_file, nodes_of

ROOT = Path(__file__).resolve().parents[1]
EXECUTES = {"problems/derived/store.py", "problems/derived/compile.py", "algebra/any_degree.py"}
UNPICKLES = {"backends/dask.py", "jit/cache.py", "cli/frames.py"}
"""Those that may: of a scheduler, of a cache of kernels, and what a command hands to its own workers."""


def calls() -> dict[str, set[str]]:
    """Files by the name of what they call, the last part of it with the part before."""
    found: dict[str, set[str]] = {}
    for path in every_file():
        for node in nodes_of(path):
            if isinstance(node, ast.Call):
                function = node.func
                name = getattr(function, "id", "")
                if isinstance(function, ast.Attribute):
                    name = f"{getattr(function.value, 'id', '?')}.{function.attr}"
                found.setdefault(name, set()).add(path.relative_to(SOURCES).as_posix())
                for keyword in node.keywords:
                    if keyword.arg in ("shell", "allow_pickle") and getattr(keyword.value, "value", True) is not False:
                        found.setdefault(f"{keyword.arg}=", set()).add(str(path))
    return found


def test_what_executes_text_is_said() -> None:
    made = calls()
    assert made.get("exec", set()) == EXECUTES
    never = "eval", "os.system", "os.popen", "yaml.unsafe_load", "marshal.loads", "shell=", "allow_pickle=", "yaml.load"
    for name in never:
        assert name not in made, f"{name} in {made.get(name)}"
    assert made["loader.construct_document"] == {"io/calibrations/values.py"}
    assert "class Loader(yaml.SafeLoader)" in (SOURCES / "io/calibrations/values.py").read_text(encoding="utf-8")
    assert made.get("pickle.loads", set()) | made.get("pickle.load", set()) <= UNPICKLES
    text = " ".join((ROOT / "SECURITY.md").read_text(encoding="utf-8").split())
    for path in EXECUTES:
        assert f"`{path}`" in text


@pytest.mark.parametrize("suffix", ["yaml", "yml", "json", "xml"])
def test_a_calibration_runs_nothing(tmp_path: Path, suffix: str) -> None:
    mark = tmp_path / "mark"
    path = tmp_path / f"camera.{suffix}"
    texts = {
        "json": '{"__reduce__": "os.system", "K": "__import__(\'os\')"}',
        "xml": f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b SYSTEM "file://{tmp_path}/secret">]><a>&b;</a>',
    }
    made = f"!!python/object/apply:pathlib.Path ['{mark}']"
    path.write_text(texts.get(suffix, f"K: !!python/object/apply:pathlib.Path.touch [{made}]"))
    with pytest.raises(InputError):
        rm.read_cameras(path)
    assert not mark.exists()


@pytest.mark.parametrize(
    "statement",
    [
        "import os",
        "x = __import__('os')",
        "x = (1).__class__",
        "x = a[0]",
        "x = [a for a in (1,)]",
        "x = lambda: 1",
        "x = 'text'",
        "x = a if a else 1",
        "x = sqrt.__globals__",
        "sqrt = a",
        "x = (y := a)",
        "while a: pass",
        "x = a ** 99999999",
        "global x",
    ],
)
def test_a_formula_is_arithmetic_or_not_run(statement: str) -> None:
    text = f"plan = {{}}\n\ndef f(a):\n    {statement}\n    return (a,)\n"
    with pytest.raises(RootmatchError, match="nothing of the file was run"):
        compile_vetted(text)
    good = compile_vetted(text.replace(statement, "x = sqrt(a) + 2.0 * a"))
    assert np.allclose(good.functions["f"](4.0), (4.0,))


def test_documents_name_the_boundary() -> None:
    for path, words in (("backends/dask.py", "SECURITY.md"), ("problems/derived/store.py", "SECURITY.md")):
        assert words in (SOURCES / path).read_text(encoding="utf-8")

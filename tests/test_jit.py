"""Numba's insides are used in one folder, and matching works without each of them."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from source_files import SOURCES, every_file, nodes_of

DOCUMENTED = {
    "numba": {"njit", "cuda", "get_num_threads", "set_num_threads", "__version__"},
    "numba.extending": {"overload"},
}
"""What may be used outside of jit/, by module."""
INSIDES = {
    "__code__", "co_consts", "co_names", "co_code", "signatures", "nopython_signatures", "stats", "py_func",
    "overloads", "targetoptions", "targetdescr", "targetctx", "typingctx", "instance_class", "get_call_template",
    "get_call_type", "inspect_llvm", "inspect_asm", "enable_caching",
}  # fmt: skip
"""Attributes of jitted functions, of Numba's types and of bytecode."""


def insides_used(nodes: list[ast.AST]) -> list[str]:
    """What a module uses that Numba or Python does not promise."""
    names, found = {}, []
    for node in nodes:
        if isinstance(node, ast.Import):
            for one in node.names:
                if one.name.split(".")[0] in ("numba", "llvmlite", "numba_cuda"):
                    names[one.asname or one.name] = one.name
                    if one.name != "numba":
                        found.append(one.name)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in (
            "numba",
            "llvmlite",
            "numba_cuda",
        ):
            allowed = DOCUMENTED.get(node.module or "", set())
            found += [f"{node.module}.{one.name}" for one in node.names if one.name not in allowed]
        elif isinstance(node, ast.Attribute) and node.attr in INSIDES:
            found.append(node.attr)
        elif isinstance(node, ast.Constant) and node.value in INSIDES:
            found.append(str(node.value))
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in names:
            module = names[node.value.id]
            if node.attr not in DOCUMENTED.get(module, set()):
                found.append(f"{module}.{node.attr}")
    return found


def test_insides_are_used_in_jit_alone() -> None:
    outside = [path for path in every_file() if path.parent != SOURCES / "jit"]
    assert len(outside) > 150
    faults = {str(path.relative_to(SOURCES)): used for path in outside if (used := insides_used(nodes_of(path)))}
    assert faults == {}


@pytest.mark.parametrize(
    "text",
    [
        "from numba.core import types",
        "import llvmlite.binding",
        "from numba.extending import lower_builtin",
        "from numba.cuda.extending import overload",
        "import numba\nnumba.core.registry",
        "kernel.py_func.__code__",
        "getattr(kernel, 'signatures')",
        "tables.instance_class",
    ],
)
def test_an_inside_is_noticed(text: str) -> None:
    assert insides_used(list(ast.walk(ast.parse(text))))


def test_jit_uses_them() -> None:
    assert {name for path in (SOURCES / "jit").glob("*.py") for name in insides_used(nodes_of(path))} > {
        "numba.core.registry.CPUDispatcher", "numba.extending.lower_builtin", "py_func", "co_consts",
    }  # fmt: skip


WITHOUT = """
import builtins, json, os, sys, types as python_types, warnings
import numba, numba.core.typing.templates, numba.extending

for GONE, CHANGED, MATCHES in json.loads(sys.argv[1]):
    if child := os.fork():  # each case is told of the same Numba, which takes as long to import as all the rest
        assert os.waitpid(child, 0)[1] == 0
    else:
        break
else:
    sys.exit()
original = builtins.__import__


class Changed:
    def __init__(self):
        pass


def importing(name, globals=None, locals=None, fromlist=(), level=0):
    # to rootmatch alone: Numba itself goes on with what it has
    if str((globals or {}).get("__name__")).startswith("rootmatch."):
        for one in fromlist or ():
            if [name, one] in GONE:
                raise ImportError(f"cannot import name {one!r} from {name!r}")
            if [name, one] in CHANGED:
                return python_types.SimpleNamespace(**{one: Changed})
    return original(name, globals, locals, fromlist, level)


builtins.__import__ = importing
found = {}
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    import rootmatch as rm, rootmatch.api
    from rootmatch.precompile.scenes import sample
    if MATCHES:
        # of all problems and ways to match these kernels are the quickest to compile
        scene, how = sample("similarity"), {"residual": "qr", "sampler": "exhaustive", "solver": "power-l1"}
        match = rm.match(scene.source, scene.target, scene.problem, noise=scene.noise, seed=1, **how)
        found["match"] = match.assignment.tolist(), list(range(8)), match.score
found["warnings"] = [str(one.message) for one in caught if issubclass(one.category, RuntimeWarning)]
print(json.dumps(found))
"""
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
DISPATCHER = ["numba.core.registry", "CPUDispatcher"]
COMPILER = ["numba.core", "compiler"]
TEMPLATE = ["numba.core.typing.templates", "AbstractTemplate"]
LOWER = ["numba.extending", "lower_builtin"]
MODEL = ["numba.core", "datamodel"]
RUNTIME = ["numba.core.runtime.nrt", "rtsys"]
INLINED, ENTRIES, BETWEEN, COUNTED = "need not be inlined", "compiled for Python too", "in between", "are counted"
KEPT = "come with it cannot be used"


def without(folder: Path, *cases: tuple[list[list[str]], list[list[str]], bool]) -> list[dict]:
    """What processes find to which insides of Numba are gone or changed, and whether they are to match."""
    # compiled code would be found on disk, whatever it was compiled with; optimising it takes longer than running it
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": os.pathsep.join(sys.path)}
    environment["NUMBA_OPT"] = "0"
    program = [sys.executable, "-c", WITHOUT, json.dumps(cases)]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return [json.loads(line) for line in done.stdout.splitlines()]


LOSSES: dict[str, tuple[list[list[str]], list[list[str]], list[str]]] = {
    "nothing": ([], [], []),
    "dispatcher": ([DISPATCHER], [], [ENTRIES, KEPT]),
    "dispatcher changed": ([], [DISPATCHER], [ENTRIES, KEPT]),
    "runtime": ([RUNTIME], [], [KEPT]),
    "compiler": ([COMPILER], [], [INLINED, ENTRIES]),
    "template": ([TEMPLATE], [], [BETWEEN]),
    "model": ([MODEL], [], [COUNTED]),
    "lower": ([LOWER], [], [BETWEEN, COUNTED]),
}
"""What is gone, what is changed, and what is told then."""


@pytest.fixture(scope="module")
def told_of_each(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The warnings of each loss."""
    cases = [(gone, changed, False) for gone, changed, _ in LOSSES.values()]
    found = without(tmp_path_factory.mktemp("losses"), *cases)
    return {name: one["warnings"] for name, one in zip(LOSSES, found, strict=True)}


@needs_fork
@pytest.mark.parametrize("name", LOSSES)
def test_each_loss_is_told_once(told_of_each: dict[str, list[str]], name: str) -> None:
    told, losses = told_of_each[name], LOSSES[name][2]
    assert len(told) == len(losses)
    for loss in losses:
        assert sum(loss in one for one in told) == 1


@needs_fork
def test_matching_works_without(tmp_path: Path) -> None:
    """Without any of them: to compile the match takes most of the time, and each has a fallback of its own."""
    (found,) = without(tmp_path, ([DISPATCHER, MODEL, COMPILER, TEMPLATE], [], True))
    assignment, truth, score = found["match"]
    assert assignment == truth
    assert score == pytest.approx(56.0, abs=0.1)  # of as many hyper-edges
    assert found["warnings"]


def test_single_precision_falls_back_to_double(monkeypatch: pytest.MonkeyPatch) -> None:
    from rootmatch.algebra.vector import dot
    from rootmatch.jit import float32
    from rootmatch.jit.fallback import JitFallbackWarning
    from rootmatch.simulation import up2p_scene

    def unlike(function: object) -> object:
        raise TypeError("code() got an unexpected argument")

    scene = up2p_scene(5, 0, 0.5, 1)
    tables = scene.problem.prepare(scene.source, scene.target[scene.truth], 0.5)
    monkeypatch.setattr(float32, "_remake_function", unlike)
    float32.can_remake.cache_clear()
    try:
        with pytest.warns(JitFallbackWarning, match="single precision"):
            kernel = float32.kernel_for_tables(float32.round_tables(tables), dot)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            again = float32.kernel_for_tables(float32.round_tables(tables), dot)
        assert kernel is again is dot
    finally:
        monkeypatch.undo()
        float32.can_remake.cache_clear()
    assert float32.kernel_for_tables(float32.round_tables(tables), dot) is not dot


def kernels_of(path: Path) -> list[ast.FunctionDef]:
    """The functions of a module that are compiled."""
    names = {"part", "scalar", "kernel", "driver"}
    functions = [node for node in nodes_of(path) if isinstance(node, ast.FunctionDef)]
    return [one for one in functions if {ast.unparse(by).partition("(")[0] for by in one.decorator_list} & names]


def test_no_kernel_asks_whether_a_number_is_finite_but_by_comparing() -> None:
    kernels = [(path.name, one) for path in every_file() for one in kernels_of(path)]
    assert len(kernels) > 100
    assert [f"{name}: {one.name}" for name, one in kernels if "isfinite" in ast.unparse(one)] == []


def test_comparing_tells_what_is_finite_where_arithmetic_is_reordered() -> None:
    from numba import njit

    from rootmatch.jit.decorators import FASTMATH

    @njit(fastmath=FASTMATH, error_model="numpy")  # type: ignore[untyped-decorator]
    def finite(a, b, c):  # type: ignore[no-untyped-def]
        return abs(a + b + c) < float("inf")

    nan, infinity = float("nan"), float("inf")
    assert finite(1.0, -2.0, 3.0)
    for values in ((1.0, nan, 2.0), (infinity, 0.0, 1.0), (-infinity, infinity, 1.0), (0.0, 1.0, -infinity)):
        assert not finite(*values), values

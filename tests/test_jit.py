"""Numba's insides are used in one folder."""

from __future__ import annotations

import ast
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

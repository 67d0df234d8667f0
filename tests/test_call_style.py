"""Long lists of arguments are passed by name: a call with six positional ones cannot be read."""

from __future__ import annotations

import ast
from collections.abc import Iterable

from source_files import SOURCES, every_file, nodes_of, tree_of

MAXIMUM = 5
KERNELS = {"launch", "fill_triangle_frame", "search"}
"""Plain functions that hand their arguments on to a kernel."""
JITTED = {
    "njit",
    "scalar",
    "kernel",
    "part",
    "internal_function",
    "driver",
    "call_by_types",
    "choose_by_types",
    "jit",
    "overload",
}
"""Decorators of compiled code, where arguments have no names, and of what chooses it."""


def decorators(node: ast.FunctionDef) -> set[str]:
    """Names of a function's decorators."""
    found = set()
    for decorator in node.decorator_list:
        called = decorator.func if isinstance(decorator, ast.Call) else decorator
        found.add(called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", ""))
    return found


def compiled_names(nodes: Iterable[ast.AST]) -> set[str]:
    """Names of all functions that are compiled, and of those for which compiled code is chosen by type."""
    names = set()
    for node in nodes:
        if isinstance(node, ast.FunctionDef) and decorators(node) & JITTED:
            names.add(node.name)
            for decorator in node.decorator_list:
                if isinstance(decorator, ast.Call):
                    names |= {argument.id for argument in decorator.args if isinstance(argument, ast.Name)}
    return names


def long_calls(tree: ast.AST, compiled: set[str]) -> list[tuple[int, str]]:
    """Lines and names of calls with too many positional arguments, outside of compiled functions."""
    found: list[tuple[int, str]] = []
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef) and decorators(node) & JITTED:
            continue
        if isinstance(node, ast.Call) and len(node.args) > MAXIMUM:
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "?")
            # what is looked up by index is a kernel: of a table of them, or configured for its launch
            if name not in compiled | KERNELS and not isinstance(node.func, ast.Subscript):
                found.append((node.lineno, name))
        found += long_calls(node, compiled)
    return found


def test_no_call_passes_more_than_five_positional_arguments() -> None:
    compiled = compiled_names(node for path in every_file() for node in nodes_of(path))
    assert compiled  # the search found the compiled functions
    found = [
        f"{path.relative_to(SOURCES)}:{line} {name}"
        for path in every_file()
        for line, name in long_calls(tree_of(path), compiled)
    ]
    assert not found, "\n".join(found)


def test_the_search_finds_such_a_call() -> None:
    tree = ast.parse(
        "def plain():\n    other(1, 2, 3, 4, 5, 6)\n    other(1, 2, 3, 4, 5)\n    quick(1, 2, 3, 4, 5, 6)\n"
    )
    assert long_calls(tree, {"quick"}) == [(2, "other")]

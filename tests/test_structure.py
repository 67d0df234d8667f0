"""What keeps the package easy to move in: one place for each thing, and a pipeline that fits on a screen."""

from __future__ import annotations

import ast
from functools import cache

from source_files import SOURCES, every_file, nodes_of, tree_of


@cache
def nodes() -> list[tuple[str, ast.Call | ast.keyword | ast.FunctionDef]]:
    """Calls, keywords and functions of each file."""
    return [
        (path.relative_to(SOURCES).as_posix(), node)
        for path in every_file()
        for node in nodes_of(path)
        if isinstance(node, ast.Call | ast.keyword | ast.FunctionDef)
    ]


def callers(name: str) -> set[str]:
    """Files that call a function of that name."""
    return {
        path
        for path, node in nodes()
        if isinstance(node, ast.Call) and name in (getattr(node.func, "id", ""), getattr(node.func, "attr", ""))
    }


def test_noise_is_parsed_in_one_place() -> None:
    assert callers("check_noise") == {"problems/noise.py"}
    assert callers("parse_noise") == {"problems/base.py"}  # as given, and as estimated


def test_points_are_validated_by_the_problem_alone() -> None:
    assert callers("validated") == {"explain/task.py", "problems/base.py"}
    assert callers("check_source") == {"matcher.py", "problems/base.py"}  # a matcher checks its source once
    assert callers("check_points") == {"problems/base.py", "hypergraph/invariants.py"}  # invariants are no problem


def test_the_pipeline_fits_on_a_screen() -> None:
    for file, names in (
        ("api.py", ["match"]),
        ("explain/explain.py", ["explain", "_explain_in_time", "_explain_motion"]),
    ):
        tree = tree_of(SOURCES / file)
        bodies = {node.name: node.body for node in tree.body if isinstance(node, ast.FunctionDef)}
        for name in names:
            first, last = bodies[name][1], bodies[name][-1]  # without the docstring
            assert (last.end_lineno or 0) - first.lineno < 40


def test_one_function_decides_and_one_reports() -> None:
    """Stages state facts: nobody else makes a status of them, or a match of what was found."""
    assert callers("Match") == {"result.py"}
    assert callers("decide") == {"explain/decide.py"}  # `Facts.status`
    made = {path for path, node in nodes() if isinstance(node, ast.keyword) and node.arg == "status"}
    assert made <= {"research/store.py"}


JITTED = {"driver", "kernel", "part", "scalar", "internal_function", "njit", "keep_on_disk"}


def slow_to_compile(function: ast.FunctionDef) -> list[int]:
    """Lines of a jitted function that sort, or assign an array to a slice.

    Numba takes a second to compile its sort, and for such an assignment several: it compiles the words of an error
    about shapes, and of strings and lists what these need.
    """
    names = {getattr(getattr(decorator, "func", decorator), "id", "") for decorator in function.decorator_list}
    lines: list[int] = []
    for node in ast.walk(function) if names & JITTED else ():
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("sort", "argsort", "median"):
            lines.append(node.lineno)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Name | ast.Subscript):
            lines += [
                node.lineno
                for target in node.targets
                if isinstance(target, ast.Subscript)
                for part in getattr(target.slice, "elts", [target.slice])
                if isinstance(part, ast.Slice)
            ]
    return lines


def test_kernels_hold_nothing_that_takes_seconds_to_compile() -> None:
    example = "@part\ndef f(a, b):\n    a[:] = 0.0\n    a[0] = b[0]\n    a[:] = b\n    a[0, :] = b[0]\n    np.sort(a)\n"
    for text, lines in ((example, [5, 6, 7]), (example.replace("@part\n", ""), [])):
        (function,) = ast.parse(text).body
        assert isinstance(function, ast.FunctionDef)
        assert slow_to_compile(function) == lines
    functions = [(path, node) for path, node in nodes() if isinstance(node, ast.FunctionDef)]
    assert {(path, node.name) for path, node in functions if slow_to_compile(node)} == set()

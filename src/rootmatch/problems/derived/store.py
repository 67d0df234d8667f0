"""Generated modules on disk: readable Python, kept between processes, and never run unseen.

A generated module holds one literal (the plan) and functions of plain arithmetic, nothing else. Before anything of it
is compiled its syntax tree is held against a short list of what may occur: no import, attribute, subscript, loop,
comparison, or call of anything but a few functions of numbers. What passes can only compute numbers; whether they are
the right ones is checked numerically afterwards, at every load. The folder is created for its owner alone, and a file
that others could have written is not read. SECURITY.md says the same.
"""

from __future__ import annotations

import ast
import os
import re
import stat
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from rootmatch.errors import InputError, RootmatchError

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "exp": np.exp,
    "log": np.log,
}
"""What generated functions may call; all take arrays too."""
_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.USub)
_NAME = re.compile(r"[a-z][a-zA-Z0-9_]*\Z")


@dataclass(frozen=True)
class Generated:
    """A vetted generated module, equal to every one of the same text."""

    text: str
    """Its source."""
    plan: dict[str, Any] = field(compare=False)
    """The literal that says what the functions take and give."""
    functions: dict[str, Callable[..., Any]] = field(compare=False)
    """Plain Python functions of numbers, or of arrays alike."""

    def __repr__(self) -> str:
        return f"Generated({len(self.functions)} functions)"


def compile_vetted(text: str, where: str = "generated") -> Generated:
    """Compile a generated module after its syntax tree has been checked against what is allowed.

    Raises `RootmatchError` if anything else occurs; nothing has been executed then.
    """
    try:
        tree = ast.parse(text, where)
    except (SyntaxError, ValueError) as error:
        raise RootmatchError(f"{where}: no Python text ({error}); delete the file") from None
    plan: dict[str, Any] | None = None
    functions: list[ast.stmt] = []
    names = []
    for number, node in enumerate(tree.body):
        if number == 0 and _is_text(node):
            continue
        if isinstance(node, ast.Assign) and plan is None and _target_name(node) == "plan":
            try:
                plan = ast.literal_eval(node.value)
            except ValueError:
                raise _refusal(where, node.value) from None
            continue
        if isinstance(node, ast.FunctionDef):
            _check_function(node, where)
            functions.append(node)
            names.append(node.name)
            continue
        raise _refusal(where, node)
    if not isinstance(plan, dict):
        raise RootmatchError(f"{where}: it holds no plan; delete the file")
    # nothing but the functions that were looked at is compiled
    namespace: dict[str, Any] = {"__builtins__": {}, "__name__": __name__, **FUNCTIONS}
    exec(compile(ast.Module(functions, []), where, "exec"), namespace)
    return Generated(text, plan, {name: namespace[name] for name in names})


def _refusal(where: str, node: ast.AST) -> RootmatchError:
    line = getattr(node, "lineno", "?")
    return RootmatchError(
        f"{where}, line {line}: {type(node).__name__} does not occur in generated code; nothing of the file was run: "
        "delete it"
    )


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _target_name(node: ast.Assign) -> str | None:
    if len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
        return node.targets[0].id
    return None


def _check_function(node: ast.FunctionDef, where: str) -> None:
    arguments = node.args
    plain = not (
        node.decorator_list
        or node.returns
        or getattr(node, "type_params", None)
        or arguments.posonlyargs
        or arguments.kwonlyargs
        or arguments.vararg
        or arguments.kwarg
        or arguments.defaults
        or any(argument.annotation for argument in arguments.args)
    )
    known = {argument.arg for argument in arguments.args}
    if not plain or not all(_NAME.match(name) for name in (node.name, *known)) or node.name in FUNCTIONS:
        raise _refusal(where, node)
    for number, statement in enumerate(node.body):
        if number == 0 and _is_text(statement):
            continue
        if isinstance(statement, ast.Assign):
            target = _target_name(statement)
            _check_arithmetic(statement.value, known, where)
            if target is None or not _NAME.match(target) or target in FUNCTIONS:
                raise _refusal(where, statement)
            known.add(target)
        elif isinstance(statement, ast.Return) and isinstance(statement.value, ast.Tuple):
            for element in statement.value.elts:
                _check_arithmetic(element, known, where)
        else:
            raise _refusal(where, statement)


def _check_arithmetic(node: ast.AST, known: set[str], where: str) -> None:
    waiting = [node]
    while waiting:
        part = waiting.pop()
        if isinstance(part, ast.BinOp) and isinstance(part.op, _OPERATORS):
            waiting += [part.left, part.right]
        elif isinstance(part, ast.UnaryOp) and isinstance(part.op, _OPERATORS):
            waiting.append(part.operand)
        elif isinstance(part, ast.Call):
            call = isinstance(part.func, ast.Name) and part.func.id in FUNCTIONS and len(part.args) == 1
            if not call or part.keywords:
                raise _refusal(where, part)
            waiting += part.args
        elif isinstance(part, ast.Constant) and type(part.value) in (int, float):
            continue
        elif not (isinstance(part, ast.Name) and part.id in known):
            raise _refusal(where, part)


def shipped_file(problem: str) -> Path:
    """The file of the formulas that come with the package, in the folder of their problem.

    `rootmatch.derivation.shipped` wrote it from the equations, so that a match needs no SymPy.
    """
    return Path(__file__).parents[1] / problem / "formulas.txt"


@cache
def shipped_formulas(problem: str) -> Generated:
    """The formulas of such a file, vetted like any generated text."""
    return compile_vetted(shipped_file(problem).read_text(encoding="utf-8"), problem)


def folder() -> Path:
    """The user's folder of generated modules: ``ROOTMATCH_CACHE_DIR``, or the platform's cache folder."""
    given = os.environ.get("ROOTMATCH_CACHE_DIR")
    if given:
        return Path(given).expanduser()
    base = os.environ.get("LOCALAPPDATA") if os.name == "nt" else os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "rootmatch" / "derived"


def save(text: str, stem: str) -> Path | None:
    """Write a generated module whole or not at all; None if the folder cannot be used."""
    place = folder()
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_private(place):
            return None
        handle, draft = tempfile.mkstemp(dir=place, prefix=".draft-", suffix=".py")  # readable by the owner alone
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            path = place / f"{stem}.py"
            Path(draft).replace(path)
        except BaseException:
            Path(draft).unlink(missing_ok=True)
            raise
    except OSError:
        return None
    return path


def load(stem: str) -> Generated | None:
    """The generated module of that name; None if there is none that can be trusted."""
    place = folder()
    path = place / f"{stem}.py"
    try:
        if not (path.is_file() and _is_private(place) and _is_private(path)):
            return None
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    return compile_vetted(text, str(path))


def _is_private(path: Path) -> bool:
    """Whether only this user can write there (where the system tells)."""
    if not hasattr(os, "getuid"):
        return True
    status = path.stat()
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def check_stem(name: str) -> str:
    """A problem's name as part of a file name."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}", name):
        raise InputError(f"name: {name!r} given; give a word of letters, digits, - and _, at most 40 long")
    return name

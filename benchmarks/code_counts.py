"""Count what the design counts: lines, and how many places do the same thing.

    python benchmarks/code_counts.py
    python benchmarks/code_counts.py --against ../old-checkout       # before and after in one table
    python benchmarks/code_counts.py --list fit "Gauss-Newton"       # the places behind rows with these words

The counts are read from the syntax trees of ``src/rootmatch``; nothing is imported. That one function decides a status
and one makes a `Match` is a test (tests/test_structure.py). What a row counts:

* code: lines with a token that is no comment and no docstring.
* laziness: each kind that occurs, by its name.
* likelihoods: modules with a function that takes the logarithm of something named after clutter, a density, a rate,
  a chance, visibility or odds, outside of ``model/``; and modules that import ``model/``, when there is one.
  A likelihood with other names is not seen, and an odds ratio of something else counts.
* fitters: functions whose return annotation is a `Pose` or a class named after a fit; those that hand on another's
  result count as well. Compiled functions have no annotations: they are seen as loops below.
* Gauss-Newton loops: functions that solve dense equations within a loop, by NumPy or by a hand-written solve (a
  function with a solver's name and nested loops). Newton's method in closed form is not seen, and one solve for each
  of several things counts.
* tuned numbers: calls of `option`, numeric defaults of classes named after options, constants of modules, and what says
  of itself that it is a round value or not tuned. A number within an expression is not seen.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
Function = ast.FunctionDef | ast.AsyncFunctionDef
Places = list[str]
CLUTTER = re.compile(r"clutter|densit|detect|visible|chance|odds|\brate|_rate|area|uniform", re.IGNORECASE)
SOLVER = re.compile(r"^_?(solve|solved|factored|cholesky|eliminat\w*)$")
UNTUNED = re.compile(r"round\s+value|not\s+tuned", re.IGNORECASE)
LAZY_NAMES = ("OnDemand", "Once", "unread", "changed", "DeferredTensor", "cached_property")


@dataclass
class Module:
    """One file."""

    name: str
    text: str
    tree: ast.Module = field(repr=False)

    @cached_property
    def functions(self) -> list[Function]:
        """All of them, methods and inner ones included."""
        return [node for node in ast.walk(self.tree) if isinstance(node, Function)]

    @cached_property
    def imported(self) -> dict[str, tuple[str, str]]:
        """Module and name of what ``from … import`` brings, by its name here."""
        found = {}
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                found |= {alias.asname or alias.name: (node.module, alias.name) for alias in node.names}
        return found

    @cached_property
    def modules_imported(self) -> set[str]:
        """Names of modules, with those of what may be modules."""
        found = {f"{module}.{name}" for module, name in self.imported.values()}
        found |= {module for module, _ in self.imported.values()}
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
        return found

    def place(self, node: ast.AST) -> str:
        """File and line."""
        return f"{self.name.replace('.', '/')}.py:{getattr(node, 'lineno', 0)}"


class Code:
    """The package below a checkout."""

    def __init__(self, root: Path) -> None:
        source = root / "src"
        if not (source / "rootmatch").is_dir():
            raise SystemExit(f"{root}: no src/rootmatch below it; give a checkout of the repository")
        self.modules = []
        for path in sorted((source / "rootmatch").rglob("*.py")):
            text = path.read_text()
            name = ".".join(path.relative_to(source).with_suffix("").parts)
            self.modules.append(Module(name, text, ast.parse(text)))

    def each(self, find: Callable[[Module], Iterator[ast.AST]]) -> Places:
        """Places of what is found in each module."""
        return [module.place(node) for module in self.modules for node in find(module)]

    def lines(self) -> int:
        """All lines."""
        return sum(module.text.count("\n") for module in self.modules)

    def code_lines(self) -> int:
        """Those of code."""
        return sum(len(code_lines(module)) for module in self.modules)

    def laziness(self) -> Places:
        """Kinds of laziness with the number of modules that use each."""
        users: Counter[str] = Counter()
        for module in self.modules:
            nodes = list(ast.walk(module.tree))
            names = {node.id for node in nodes if isinstance(node, ast.Name)}
            users.update(name for name in LAZY_NAMES if name in names)
            calls = [node for node in nodes if isinstance(node, ast.Call)]
            if any(updates_attributes(node) for node in calls):
                users["vars(…).update"] += 1
        return [f"{name} in {count} modules" for name, count in users.items()]

    def likelihoods(self) -> Places:
        """Modules with a likelihood of their own."""

        def find(module: Module) -> Iterator[ast.AST]:
            for function in module.functions:
                for node in ast.walk(function):
                    logarithm = isinstance(node, ast.Call) and called(node) in ("log", "log1p", "log10", "logaddexp")
                    if logarithm and any(CLUTTER.search(name) for one in node.args for name in names_in(one)):  # type: ignore[attr-defined]
                        yield function
                        return

        outside = (module for module in self.modules if not module.name.startswith("rootmatch.model."))
        return [module.place(node) for module in outside for node in find(module)]

    def users_of_the_model(self) -> Places:
        """Modules outside of it that import the one model."""
        return [
            module.name
            for module in self.modules
            if not module.name.startswith("rootmatch.model")
            and any(re.match(r"rootmatch\.model(\.|$)", name) for name in module.modules_imported)
        ]

    def fitters(self) -> Places:
        """Functions that return a pose or a fit."""

        def find(module: Module) -> Iterator[ast.AST]:
            for function in module.functions:
                written = "" if function.returns is None else ast.unparse(function.returns)
                if re.search(r"\b(Pose|\w*Fit)\b", written.strip("'\"")):
                    yield function

        return self.each(find)

    def gauss_newton(self) -> Places:
        """Functions with a loop that solves dense equations."""
        by_hand = {
            (module.name, function.name)
            for module in self.modules
            for function in module.functions
            if SOLVER.match(function.name) and depth(function) >= 2
        }

        def find(module: Module) -> Iterator[ast.AST]:
            for function in module.functions:
                loops = [node for node in ast.walk(function) if isinstance(node, ast.For | ast.While)]
                calls = [one for loop in loops for one in ast.walk(loop) if isinstance(one, ast.Call)]
                for call in calls:
                    name, written = called(call), ast.unparse(call.func)
                    home = module.imported.get(name, (module.name, name))
                    if re.search(r"linalg\.(solve|lstsq)$", written) or (
                        isinstance(call.func, ast.Name)
                        and home in by_hand
                        and (module.name, function.name) not in by_hand
                    ):
                        yield function
                        break

        return self.each(find)

    def solves_by_hand(self) -> Places:
        """Hand-written dense solves."""
        return self.each(lambda module: (f for f in module.functions if SOLVER.match(f.name) and depth(f) >= 2))

    def options(self) -> Places:
        """Calls of `option`, and numeric defaults of classes named after options."""

        def find(module: Module) -> Iterator[ast.AST]:
            for node in ast.walk(module.tree):
                if isinstance(node, ast.ClassDef):
                    for one in node.body:
                        if isinstance(one, ast.AnnAssign) and one.value is not None:
                            given = isinstance(one.value, ast.Call) and called(one.value) == "option"
                            if given or (node.name.endswith("Options") and is_number(one.value)):
                                yield one

        return self.each(find)

    def constants(self) -> Places:
        """Numeric constants of modules."""

        def find(module: Module) -> Iterator[ast.AST]:
            for node in module.tree.body:
                if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                    for target in targets:
                        pairs = [(target, node.value)]
                        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                            pairs = list(zip(target.elts, node.value.elts, strict=False))
                        for name, value in pairs:
                            if isinstance(name, ast.Name) and name.id.lstrip("_").isupper() and is_number(value):
                                yield name

        return self.each(find)

    def untuned(self) -> Places:
        """What says of itself that it is a round value or not tuned."""
        found = []
        for module in self.modules:
            for match in UNTUNED.finditer(module.text):
                found.append(f"{module.name.replace('.', '/')}.py:{module.text.count(chr(10), 0, match.start()) + 1}")
        return found


def called(node: ast.Call) -> str:
    """Last name of what is called."""
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def updates_attributes(node: ast.Call) -> bool:
    """Whether a call writes attributes past their class: ``vars(x).update``, ``x.__dict__.update``."""
    return re.match(r"vars\(.*\)\.update$|.*__dict__\.update$", ast.unparse(node.func)) is not None


def names_in(node: ast.AST) -> Iterator[str]:
    """Names and attributes in an expression."""
    for one in ast.walk(node):
        if isinstance(one, ast.Name):
            yield one.id
        elif isinstance(one, ast.Attribute):
            yield one.attr


def depth(node: ast.AST) -> int:
    """How deep loops are nested."""
    below = max((depth(child) for child in ast.iter_child_nodes(node)), default=0)
    return below + isinstance(node, ast.For | ast.While)


def is_number(value: ast.AST) -> bool:
    """Whether an expression is made of numbers alone, or a tuple of such."""
    if isinstance(value, ast.Constant):
        return isinstance(value.value, int | float) and not isinstance(value.value, bool)
    if isinstance(value, ast.UnaryOp):
        return is_number(value.operand)
    if isinstance(value, ast.BinOp):
        return is_number(value.left) and is_number(value.right)
    if isinstance(value, ast.Tuple):
        return bool(value.elts) and all(is_number(one) for one in value.elts)
    if isinstance(value, ast.Call):
        known = re.fullmatch(r"(math|np)\.(log|log10|exp|sqrt|radians|deg2rad|cos|sin|float64|int64|int32)",
                             ast.unparse(value.func))  # fmt: skip
        return known is not None and bool(value.args) and all(is_number(one) for one in value.args)
    return isinstance(value, ast.Attribute) and ast.unparse(value) in ("math.pi", "np.pi")


def code_lines(module: Module) -> set[int]:
    """Numbers of lines with code."""
    documented: set[int] = set()
    for node in ast.walk(module.tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            for one in body:
                if (
                    isinstance(one, ast.Expr)
                    and isinstance(one.value, ast.Constant)
                    and isinstance(one.value.value, str)
                ):
                    documented |= set(range(one.lineno, (one.end_lineno or one.lineno) + 1))
    found: set[int] = set()
    silent = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    for token in tokenize.generate_tokens(io.StringIO(module.text).readline):
        if token.type not in silent:
            found |= set(range(token.start[0], token.end[0] + 1))
    return found - documented


ROWS: list[tuple[str, Callable[[Code], int | Places]]] = [
    ("files", lambda code: len(code.modules)),
    ("lines", Code.lines),
    ("lines of code", Code.code_lines),
    ("functions and methods", lambda code: sum(len(module.functions) for module in code.modules)),
    ("kinds of laziness", Code.laziness),
    ("modules with a likelihood of their own", Code.likelihoods),
    ("modules that import the one model", Code.users_of_the_model),
    ("functions that return a pose or a fit", Code.fitters),
    ("modules that have such functions", lambda code: sorted({place.partition(":")[0] for place in code.fitters()})),
    ("Gauss-Newton loops", Code.gauss_newton),
    ("hand-written dense solves", Code.solves_by_hand),
    ("options with a number", Code.options),
    ("numeric constants of modules", Code.constants),
    ("mentions of a round value, or of not tuned", Code.untuned),
]


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="checkout to compare with, the state before")
    parser.add_argument("--root", type=Path, default=ROOT, help="checkout to count; default: this one")
    parser.add_argument("--list", nargs="+", default=[], metavar="WORD", help="print the places of rows with a word")
    given = parser.parse_args()
    after = Code(given.root)
    before = Code(given.against) if given.against is not None else None
    width = max(len(name) for name, _ in ROWS)
    if before is not None:
        print(f"{'':{width}}  {'before':>8}  {'after':>8}  {'ratio':>6}")
    for name, count in ROWS:
        found = count(after)
        value = found if isinstance(found, int) else len(found)
        if before is None:
            print(f"{name:{width}}  {value:>8,}")
        else:
            old = count(before)
            was = old if isinstance(old, int) else len(old)
            print(f"{name:{width}}  {was:>8,}  {value:>8,}  {value / was if was else float('nan'):>6.2f}")
        if isinstance(found, list) and any(word.lower() in name.lower() for word in given.list):
            print("\n".join(f"    {place}" for place in found))
    return 0


if __name__ == "__main__":
    sys.exit(main())

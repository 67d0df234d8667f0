"""The files that compiled code is made of, and a digest of them: another one where compiled code may be another.

A driver is inlined from many files, while Numba looks at the driver's own. So the digest is part of the name of what is
kept on disk (`rootmatch.jit.cache`). Nothing of Numba is needed here.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1]

COMPILING = {
    "numba/njit",
    "rootmatch/jit/decorators",
    "rootmatch/jit/dispatch",
    "rootmatch/jit/internal",
    "rootmatch/problems/kernels",
}
"""Modules that a file imports if it has kernels or says which they are."""

_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+(?P<module>[\w.]+)[ \t]+import[ \t]*(?P<names>\([^)]*\)|[^\n]*)"
    r"|import[ \t]+(?P<modules>[^\n]*))",
    re.MULTILINE,
)
"""An import statement. A sentence of a docstring may look like one, which at worst adds a file."""


def imported_modules(text: str) -> set[str]:
    """The modules, as paths, that a source file names in imports; of ``from a import b``, ``a`` and ``a/b``."""
    found: set[str] = set()
    for match in _IMPORT.finditer(text):
        names = re.sub(r"#[^\n]*|[()]", "", match["names"] or match["modules"] or "").split(",")
        words = [name.split()[0] for name in names if name.strip()]
        module = match["module"]
        found |= {module, *(f"{module}.{word}" for word in words)} if module else set(words)
    return {name.replace(".", "/") for name in found}


def compiled_sources(package: Path = PACKAGE) -> list[Path]:
    """The files that compiled code is made of: those that import something of `COMPILING`, and what these import."""
    paths = {path.relative_to(package.parent).with_suffix("").as_posix(): path for path in package.rglob("*.py")}
    imports = {path: imported_modules(path.read_text(encoding="utf-8")) for path in paths.values()}
    waiting = [path for path, names in imports.items() if names & COMPILING]
    needed: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path not in needed:
            needed.add(path)
            waiting += [paths[name] for name in imports[path] if name in paths]
    return sorted(needed)


def digest(files: Iterable[Path], package: Path = PACKAGE) -> str:
    """A digest of the names and contents of files below a package."""
    whole = hashlib.sha256()
    for path in files:
        content = hashlib.sha256(path.read_bytes()).digest()
        whole.update(path.relative_to(package).as_posix().encode() + b"\0" + content)
    return whole.hexdigest()[:16]


@cache
def stamp() -> str:
    """The digest of this package's compiled code, looked at once in a process."""
    return digest(compiled_sources())

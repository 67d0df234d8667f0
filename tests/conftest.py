"""What all tests share: a place for compiled kernels, and the measured data sets."""

import ast
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


COMPILING = {
    "numba/njit",
    "rootmatch/jit/decorators",
    "rootmatch/jit/dispatch",
    "rootmatch/jit/internal",
    "rootmatch/problems/kernels",
}
"""What a file imports that has kernels, or says which they are."""


def compiled_sources(sources: Path) -> list[Path]:
    """The files that compiled code is made of: those that import something of `COMPILING`, and what these import."""
    paths = {path.relative_to(sources.parent).with_suffix("").as_posix(): path for path in sources.rglob("*.py")}
    imports: dict[Path, set[str]] = {}
    for path in paths.values():
        found: set[str] = set()
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                found |= {name.name for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
        imports[path] = {name.replace(".", "/") for name in found}
    waiting = [path for path, names in imports.items() if names & COMPILING]
    needed: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path not in needed:
            needed.add(path)
            waiting += [paths[name] for name in imports[path] if name in paths]
    return sorted(needed)


def kernel_cache_name(sources: Path) -> str:
    """Name of the cache folder of the sources under a folder: another one where compiled code may be another.

    Numba finds a compiled driver by the file of the driver alone; a kernel edited in another file would leave it
    stale and the tests would judge code that is no longer there.
    """
    digest = hashlib.sha256()
    for path in compiled_sources(sources):
        digest.update(str(path.relative_to(sources)).encode() + b"\0" + path.read_bytes() + b"\0")
    return f"sources-{digest.hexdigest()[:16]}"


def _use_kernel_cache_of_these_sources() -> None:
    """Point Numba to that folder; it belongs to this user only, because what lies in it is executed."""
    name = kernel_cache_name(ROOT / "src" / "rootmatch")
    user = os.getuid() if hasattr(os, "getuid") else "user"
    default = Path(tempfile.gettempdir()) / f"rootmatch-numba-{user}"
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or default)
    if base.name == name:  # a test run inside a test run
        return
    base.mkdir(mode=0o700, parents=True, exist_ok=True)
    if base == default and hasattr(os, "getuid") and base.stat().st_uid != os.getuid():
        base = Path(tempfile.mkdtemp(prefix="rootmatch-numba-"))
    os.environ["NUMBA_CACHE_DIR"] = str(base / name)


# Before anything imports Numba, which reads the variable once.
_use_kernel_cache_of_these_sources()

import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of measured correspondences with ground truth; tests are skipped where it is absent."""
    given = os.environ.get("ROOTMATCH_DATA")
    folder = Path(given) if given else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"measured data absent: no folder {folder}; set ROOTMATCH_DATA to it")
    return folder


@pytest.fixture(scope="session")
def load_shared(shared_data: Path) -> Callable[[str], dict[str, NDArray]]:
    """A function ``load(name)`` which gives the arrays of ``name.npz`` of the measured data."""

    def load(name: str) -> dict[str, NDArray]:
        path = shared_data / f"{name}.npz"
        if not path.is_file():
            pytest.skip(f"measured data absent: no file {path}")
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}

    return load

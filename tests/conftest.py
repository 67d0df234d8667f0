"""What all tests share: a place for compiled kernels, and the measured data sets."""

import gc
import inspect
import os
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rootmatch.jit import sources

ROOT = Path(__file__).resolve().parents[1]

gc.disable()  # while tests are imported: little is garbage then, and to look for it takes a third of that time


def _use_kernel_cache_of_these_sources() -> None:
    """Point Numba to a folder of these sources; it belongs to this user only, because what lies in it is executed."""
    name = f"sources-{sources.stamp()}"
    user = os.getuid() if hasattr(os, "getuid") else "user"
    default = Path(tempfile.gettempdir()) / f"rootmatch-numba-{user}"
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or default)
    if base.name == name:  # a test run inside a test run
        return
    base.mkdir(mode=0o700, parents=True, exist_ok=True)
    if base == default and hasattr(os, "getuid") and base.stat().st_uid != os.getuid():
        base = Path(tempfile.mkdtemp(prefix="rootmatch-numba-"))
    os.environ["NUMBA_CACHE_DIR"] = str(base / name)
    # Many tests start processes, which would all compile the same Python sources. Not in a folder of its own either
    # (PYTHONPYCACHEPREFIX): that would hide the bytecode of all that is installed.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False


# Before anything imports Numba, which reads the variable once.
_use_kernel_cache_of_these_sources()

import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

NUMERICS = re.compile(r"multivariate_normal|linalg\.(qr|svd|eigh?|lstsq)\b|\b1e-(0?[7-9]|1\d)\b")
"""In the source of a test: it draws by LAPACK, whose signs are the processor's, or compares to better than 1e-6."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark ``numerics`` on each test that matches `NUMERICS`, itself or in what it calls of its own file."""
    if "numerics" not in config.option.markexpr:
        return
    found: dict[object, bool] = {}
    for item in items:
        function = getattr(item, "function", None)
        if inspect.isfunction(function) and _matches(inspect.unwrap(function), found):
            item.add_marker("numerics")


def _matches(function: Callable[..., object], found: dict[object, bool]) -> bool:
    if function not in found:
        found[function] = False  # where functions call each other
        called = [function.__globals__.get(name) for name in function.__code__.co_names]
        found[function] = bool(NUMERICS.search(inspect.getsource(function))) or any(
            _matches(one, found) for one in called if inspect.isfunction(one) and one.__module__ == function.__module__
        )
    return found[function]


def pytest_collection_finish() -> None:
    """Look for garbage less often, and not among what was imported: it took a twentieth of the suite's time."""
    gc.freeze()
    gc.set_threshold(300_000, 20, 20)
    gc.enable()


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

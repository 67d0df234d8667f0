"""A cache of compiled code that cannot be read is compiled anew: it is left by another version, or damaged."""

from __future__ import annotations

import io
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

MODULE = """
from rootmatch.jit.decorators import driver

@driver(error_model="numpy")
def double(x):
    return 2.0 * x
"""
SCRIPT = "import kernels; print(kernels.double(1.5), sum(kernels.double.stats.cache_hits.values()))"


class Gone:
    """What an index refers to, in a module that the next process does not have."""


def of_another_version(data: bytes) -> bytes:
    """An index that refers to a class of a module which is no more."""
    Gone.__module__ = "kernels"
    sys.modules["kernels"] = sys.modules[__name__]
    try:
        gone = pickle.dumps(Gone)
    finally:
        del sys.modules["kernels"]
        Gone.__module__ = __name__
    stream = io.BytesIO(data)
    pickle.load(stream)  # Numba's own version, by itself
    return data[: stream.tell()] + gone


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "of another version": of_another_version,
    "cut short": lambda data: data[: len(data) // 2],
    "empty": lambda data: b"",
    "garbage": lambda data: b"\x80\x04" + b"garbage" * 20,
}


def run(folder: Path) -> list[str]:
    """What the script prints, the compiled code kept in the folder."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONPATH": f"{folder}{os.pathsep}{SOURCES}",
    }
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


SOURCES = Path(__file__).resolve().parents[1] / "src"


CASES = [(damage, suffix) for damage in DAMAGES for suffix in (".nbi", ".nbc")]
CASES.remove(("of another version", ".nbc"))  # which refers to nothing by name


@pytest.mark.parametrize(("damage", "suffix"), CASES)
def test_a_cache_that_cannot_be_read_is_made_anew(tmp_path: Path, damage: str, suffix: str) -> None:
    (tmp_path / "kernels.py").write_text(MODULE)
    assert run(tmp_path) == ["3.0", "0"]
    if (damage, suffix) == ("of another version", ".nbi"):
        assert run(tmp_path) == ["3.0", "1"]
    (path,) = (tmp_path / "cache").rglob(f"*{suffix}")
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    assert run(tmp_path) == ["3.0", "0"]
    assert run(tmp_path) == ["3.0", "1"]

"""A cache of compiled code that cannot be read is compiled anew: it is left by another version, or damaged."""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import FrameType

import pytest

from rootmatch.jit.cache import SUFFIX, keep_interrupts
from rootmatch.jit.signals import RAISING, defer_signals

MODULE = """
from rootmatch.jit.decorators import driver

@driver(error_model="numpy")
def double(x):
    return 2.0 * x
"""
SCRIPT = """
import importlib, sys
from pathlib import Path
import kernels

def tell():
    print(kernels.double(1.5), sum(kernels.double.stats.cache_hits.values()))

tell()
for path in map(Path, sys.argv[1:]):  # what takes the place of the module, or of its compiled code
    place = Path(kernels.__file__) if path.suffix == ".py" else next(Path(sys.path[1], "cache").rglob("*.kernel"))
    place.write_bytes(path.read_bytes())
    for _ in range(2):  # as two processes one after the other: a module imported anew has nothing compiled at hand
        importlib.invalidate_caches()
        importlib.reload(kernels)
        tell()
"""


class Gone:
    """What an index refers to, in a module that the next process does not have."""


def of_another_version(data: bytes) -> bytes:
    """What refers to a class of a module which is no more."""
    Gone.__module__ = "kernels"
    sys.modules["kernels"] = sys.modules[__name__]
    try:
        return pickle.dumps(Gone)
    finally:
        del sys.modules["kernels"]
        Gone.__module__ = __name__


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "of another version": of_another_version,
    "cut short": lambda data: data[: len(data) // 2],
    "empty": lambda data: b"",
    "garbage": lambda data: b"\x80\x04" + b"garbage" * 20,
}


def run(folder: Path, *instead: Path, **more: str) -> list[str]:
    """What the script prints, the compiled code kept in the folder; and what with other files in place of its own."""
    return printed(folder, SCRIPT, *map(str, instead), **more)


def printed(folder: Path, script: str, *arguments: str, **more: str) -> list[str]:
    """What a script prints that finds the module and keeps its compiled code in the folder."""
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONPATH": f"{folder}{os.pathsep}{SOURCES}",
        **more,
    }
    command = [sys.executable, "-c", script, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


SOURCES = Path(__file__).resolve().parents[1] / "src"


def kept(folder: Path) -> list[Path]:
    """The files of compiled code."""
    return sorted((folder / "cache").rglob(f"*{SUFFIX}"))


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the module and its compiled code, which a process has left; each test leaves both there."""
    folder = tmp_path_factory.mktemp("compiled")
    (folder / "kernels.py").write_text(MODULE)
    assert run(folder) == ["3.0 0"]
    return folder


@pytest.fixture(scope="module")
def damaged(compiled: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """What the next process says, and the one after it, once the compiled code is damaged in each of the ways."""
    (path,) = kept(compiled)
    folder = tmp_path_factory.mktemp("damages")
    for name, damage in DAMAGES.items():
        (folder / name).write_bytes(damage(path.read_bytes()))
    first, *told = run(compiled, *(folder / name for name in DAMAGES))
    assert first == "3.0 1"
    return {name: told[2 * k : 2 * k + 2] for k, name in enumerate(DAMAGES)}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_cache_that_cannot_be_read_is_made_anew(damaged: dict[str, list[str]], damage: str) -> None:
    assert damaged[damage] == ["3.0 0", "3.0 1"]


def test_an_edited_driver_is_compiled_anew_and_nothing_else_is_left(tmp_path: Path) -> None:
    edited, original = tmp_path / "edited.py", tmp_path / "original.py"
    edited.write_text(MODULE.replace("2.0 * x", "2.0 * x + 1.0"))
    for path in (original, tmp_path / "kernels.py"):
        path.write_text(MODULE)
    assert run(tmp_path, edited, original) == ["3.0 0", "4.0 0", "4.0 1", "3.0 1", "3.0 1"]
    assert {path.suffix for path in (tmp_path / "cache").rglob("*") if path.is_file()} == {SUFFIX}


def test_what_other_sources_have_left_is_removed(compiled: Path) -> None:
    (path,) = kept(compiled)
    stem, _, key = path.name.removesuffix(SUFFIX).rsplit(".", 2)
    path.rename(path.with_name(f"{stem}.{'0' * 16}.{key}{SUFFIX}"))
    assert run(compiled) == ["3.0 0"]
    assert kept(compiled) == [path]


@pytest.mark.parametrize("then", [None, RuntimeError("no compiled object yet")])
def test_an_interrupt_while_c_calls_python_is_not_lost(then: Exception | None) -> None:
    """As where LLVM hands over what it has compiled: Ctrl-C there left an error of Numba and a traceback."""

    @ctypes.CFUNCTYPE(None)
    def interrupted() -> None:
        raise KeyboardInterrupt

    hook = sys.unraisablehook

    def compiling() -> None:
        with keep_interrupts():
            interrupted()
            if then is not None:
                raise then

    with pytest.raises(KeyboardInterrupt):
        compiling()
    assert sys.unraisablehook is hook
    with pytest.raises(ValueError, match="another"), keep_interrupts():
        raise ValueError("another")


class EndedError(Exception):
    """What the handler of a timer raises."""


@pytest.fixture
def handlers() -> Iterator[None]:
    """Puts back the handlers of signals."""
    before = {number: signal.getsignal(number) for number in RAISING}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
def test_signals_wait_for_the_end_and_then_all_come() -> None:
    told: list[str] = []

    def ended(number: int, frame: FrameType | None) -> None:
        told.append(f"ended in {frame.f_code.co_name if frame else None}")
        raise EndedError

    def noted(number: int, frame: FrameType | None) -> None:
        told.append("noted")

    def work() -> None:
        with defer_signals():
            for _ in range(2):
                signal.raise_signal(signal.SIGTERM)
                signal.raise_signal(signal.SIGINT)
            told.append("whole")

    signal.signal(signal.SIGINT, ended)
    signal.signal(signal.SIGTERM, noted)
    with pytest.raises(EndedError):
        work()
    assert sorted(told[1:]) == ["ended in work", "noted"]
    assert told[0] == "whole"
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == (ended, noted)
    with pytest.raises(EndedError):
        signal.raise_signal(signal.SIGINT)  # as before
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with pytest.raises(ValueError, match="its own"), defer_signals():
        raise ValueError("its own")
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    with ThreadPoolExecutor(1) as pool:  # where no handler can be set, and none is called
        assert pool.submit(lambda: defer_signals().__enter__()).result() is None


LOADED = """
import signal, sys
from numba.core.codegen import JITCodeLibrary

signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background
before, inside = JITCodeLibrary._object_getbuffer_hook.__func__, [0]

def interrupted(cls, module):
    if sys.argv[1] == "interrupted":
        inside[0] += 1
        signal.raise_signal(signal.SIGINT)  # LLVM calls this for the code that is loaded
    return before(cls, module)

JITCodeLibrary._object_getbuffer_hook = classmethod(interrupted)
import kernels
try:
    print(kernels.double(1.5))
except KeyboardInterrupt:
    print("interrupted", inside[0] > 0)
    sys.argv[1] = ""
    print(kernels.double(1.5), sum(kernels.double.stats.cache_hits.values()))
"""


def test_an_interrupt_while_code_is_loaded_comes_after_it(compiled: Path) -> None:
    """It was lost, with the code: to call what was missing ended the process."""
    assert printed(compiled, LOADED, "interrupted") == ["interrupted True", "3.0 1"]


def test_two_processes_compile_once(tmp_path: Path) -> None:
    (tmp_path / "kernels.py").write_text(MODULE)
    with ThreadPoolExecutor(2) as pool:
        told = sorted(pool.map(run, [tmp_path] * 2))
    assert told == [["3.0 0"], ["3.0 1"]] or os.name == "nt"


def test_a_driver_serves_where_no_folder_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "kernels.py").write_text(MODULE)
    (tmp_path / "cache").write_text("a file in the way")
    (tmp_path / "__pycache__").write_text("another")
    assert run(tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache")) == ["3.0 0"]
